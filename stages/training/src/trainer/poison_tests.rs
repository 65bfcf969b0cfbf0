//! Planted NaNs in every tensor, moment and gradient of every method in every phase, and in every optional input: each
//! ends the training at that step with an error that names it.

use std::collections::BTreeMap;

use engine::{Failure, FailureKind};
use shaders::tape::{Device, Tape, Tensor};

use super::*;
use crate::data::{Dataset, Supplements};
use crate::effects::{Effects, saves_time};
use crate::methods::{self, registry};
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;

/// Steps of each phase.
const STEPS: u64 = 3;

pub(super) struct Scene {
    pub dataset: Dataset,
    pub supplements: Supplements,
    _dir: tempfile::TempDir,
}

impl Scene {
    pub(crate) fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let test_scene = TestScene { size: 16, ..TestScene::default() };
        let dataset = Dataset::load(test_scene.write(dir.path()), 1).unwrap();
        let supplements = test_scene.supplements(&dataset);
        Self { dataset, supplements, _dir: dir }
    }
}

/// Parameters with every effect of a method and few steps, so that no population changes.
pub(super) fn all_effects(method: &str) -> TrainingParams {
    let entry = methods::find(method).unwrap();
    let mut params = TrainingParams::of(method).unwrap();
    params.settings = entry.tiny();
    // Effects that save time are left out: their needs exclude those of others.
    let effects = entry.effects().into_iter().filter(|effect| !saves_time(effect));
    params.shared.effects = Effects::Named(effects.map(|effect| effect.name.to_owned()).collect());
    params.shared.iterations.values_mut().for_each(|steps| *steps = STEPS);
    params.shared.initial_points.max_count = 12;
    params.shared.curve.points = 0;
    params
}

/// A checkpoint within each phase.
pub(super) fn checkpoints(scene: &Scene, params: &TrainingParams) -> Vec<(String, Checkpoint)> {
    let mut trainer = Trainer::new(&scene.dataset, &scene.supplements, params).unwrap();
    let mut found = Vec::new();
    while !trainer.is_done() {
        trainer.advance().unwrap_or_else(|error| panic!("{}: {error:#}", params.method));
        if trainer.state.iteration == 1 {
            found.push((trainer.phase_name().to_owned(), trainer.checkpoint().unwrap()));
        }
    }
    assert!(!found.is_empty());
    found
}

/// The error of the first step after resuming from a checkpoint, if there is one.
fn end_of(scene: &Scene, params: &TrainingParams, checkpoint: Checkpoint) -> Option<Failure> {
    let resume = || {
        let mut trainer = Trainer::resume(&scene.dataset, &scene.supplements, params, checkpoint)?;
        trainer.advance()
    };
    resume().err().map(|error| error.downcast::<Failure>().expect("a typed failure"))
}

#[test]
fn a_nan_in_any_tensor_or_moment_is_named() {
    let scene = Scene::new();
    let (mut poisoned, mut complaints) = (0, Vec::new());
    for entry in registry() {
        let params = all_effects(entry.name);
        for (phase, checkpoint) in checkpoints(&scene, &params) {
            for name in checkpoint.tensors.keys() {
                let tensor = name.split_once('.').expect("a part and a tensor").1;
                let mut with_nan = checkpoint.clone();
                let values = &mut with_nan.tensors.get_mut(name).unwrap().values;
                let middle = values.len() / 2;
                values[middle] = f32::NAN;
                poisoned += 1;
                let found = end_of(&scene, &params, with_nan);
                let is_named = found.as_ref().is_some_and(|failure| {
                    let mentions = |text: &str| failure.message.contains(text);
                    failure.kind == FailureKind::Diverged
                        && mentions(tensor)
                        && mentions(&phase)
                        && mentions("iteration")
                });
                if !is_named {
                    complaints.push(format!("{} in {phase}: {name}: {found:?}", entry.name));
                }
            }
            assert!(end_of(&scene, &params, checkpoint).is_none(), "{}: without poison", entry.name);
        }
    }
    assert!(poisoned > 200, "{poisoned} tensors");
    assert!(complaints.is_empty(), "{} of {poisoned}:\n{}", complaints.len(), complaints.join("\n"));
}

#[test]
fn a_non_finite_gradient_is_named() {
    let scene = Scene::new();
    for entry in registry() {
        let params = all_effects(entry.name);
        let mut trainer = Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap();
        trainer.advance().unwrap();
        let tape = Tape::new(Device::Cpu);
        let (tensors, _) = trainer.state.optimizer.save();
        let names = tensors.keys().filter_map(|name| name.strip_prefix("value."));
        let zeros: BTreeMap<&str, Tensor<f32>> =
            names.map(|name| (name, Tensor::zeros(tensors[&format!("value.{name}")].shape.clone()))).collect();
        trainer.check_gradients(&zeros, &tape).unwrap();
        for name in zeros.keys() {
            for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let mut gradients = zeros.clone();
                let values = gradients.get_mut(name).unwrap().make_mut();
                let last = values.len() - 1;
                values[last] = poison;
                let error = trainer.check_gradients(&gradients, &tape).unwrap_err();
                let failure = error.downcast::<Failure>().expect("a typed failure");
                let named = format!("gradient of {name} is not finite at iteration");
                assert!(failure.message.contains(&named), "{failure}");
                assert!(failure.hint.as_deref().is_some_and(|hint| hint.contains("weights of losses")), "{failure}");
            }
        }
    }
}

/// Puts a NaN into one of the optional inputs.
type Poison = fn(&mut Supplements);

/// In maps a NaN marks a pixel of unknown value; elsewhere a NaN has no meaning.
const POISONS: [(&str, Poison); 7] = [
    ("depth", |all| all.priors.iter_mut().for_each(|view| view.depth.as_mut().unwrap().depth_view[100] = f32::NAN)),
    ("flow", |all| all.priors.iter_mut().for_each(|view| view.flow.as_mut().unwrap().map.flow_px[100] = [f32::NAN; 2])),
    ("normals", |all| {
        all.priors.iter_mut().for_each(|view| view.normals.as_mut().unwrap().normals_view[100] = [f32::NAN; 3]);
    }),
    ("velocity", |all| {
        all.priors.iter_mut().for_each(|view| view.velocity.as_mut().unwrap().velocity_world[100] = [f32::NAN; 3]);
    }),
    ("tokens", |all| {
        all.features.as_mut().unwrap().visual.iter_mut().flatten().for_each(|tokens| tokens.make_mut()[5] = f32::NAN);
    }),
    ("particles", |all| all.particles.as_mut().unwrap().positions[1][2] = f32::NAN),
    ("depth of the background", |all| {
        let maps = all.background.iter_mut().flatten().filter_map(|view| view.depth.as_mut());
        maps.for_each(|depth| depth.depth_view[100] = f32::NAN);
    }),
];

#[test]
fn a_nan_in_an_optional_input_is_ignored_or_ends_the_training() {
    let scene = Scene::new();
    let (mut ended, mut went_on) = (Vec::new(), Vec::new());
    for entry in registry() {
        let params = all_effects(entry.name);
        for (what, poison) in POISONS {
            let mut supplements = scene.supplements.clone();
            poison(&mut supplements);
            let train = || -> anyhow::Result<Model> {
                let mut trainer = Trainer::new(&scene.dataset, &supplements, &params)?;
                while !trainer.is_done() {
                    trainer.advance()?;
                }
                trainer.finish()
            };
            match train() {
                Ok(model) => {
                    let is_finite = |tensor: &crate::NamedTensor| tensor.values.iter().all(|value| value.is_finite());
                    assert!(model.tensors.values().all(is_finite), "{}: {what}", entry.name);
                    went_on.push((entry.name, what));
                }
                Err(error) => {
                    let failure = error.downcast::<Failure>().expect("a typed failure");
                    ended.push(format!("{}: {what}: {failure}", entry.name));
                }
            }
        }
    }
    println!("ended:\n{}", ended.join("\n"));
    // An input that a method does not read has no effect on it.
    assert!(went_on.iter().any(|(method, what)| *method == "static3dgs" && *what == "tokens"));
    assert!(ended.iter().any(|line| line.starts_with("l4dgs: tokens")), "{ended:?}");
}
