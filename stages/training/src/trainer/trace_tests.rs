//! Writes a training step by step to files, with which other programs compare themselves (`tests/parity`).
//!
//! `PARITY_REQUEST` names a file `{ "params": {…}, "steps": N, "noise": […], "uniform": […] }` with keys of `params` as in a
//! recipe, `PARITY_CAPTURE` a capture, and `PARITY_TRACE` the folder to write into: `scene.safetensors` (images, and as
//! metadata the cameras, times and facts), and for each step from 0 on `NNNNN.safetensors`: the state after the step
//! (`value.`, `first_moment.`, `second_moment.`), its gradients (`gradient.`) and random draws (`noise.`), and as
//! metadata its losses, views and learning rates, and the statistics of the step hooks.

use std::path::{Path, PathBuf};

use rand::RngExt as _;
use rand_distr::{Distribution as _, StandardNormal};
use scene::Capture;
use serde::Deserialize;
use serde_json::{Value, json};

use super::tests::dataset;
use super::train_state::{SavedState, TrainState};
use super::*;
use crate::artifact::{NamedTensor, write_tensors};
use crate::data::{Dataset, NOTHING};
use crate::method::StepOutcome;
use crate::params::TrainingParams;
use crate::planning::resolve_for;
use crate::scene_tests::TestScene;

/// Draws that are written for each purpose of a step.
const DRAWS: usize = 60_000;

type Tensors = std::collections::BTreeMap<String, NamedTensor>;

#[derive(Deserialize)]
struct Request {
    params: TrainingParams,
    steps: u64,
    /// Purposes whose draws are normal, e.g. `split`.
    noise: Vec<String>,
    /// Purposes whose draws are uniform, e.g. `rigidity`.
    #[serde(default)]
    uniform: Vec<String>,
}

#[test]
fn write_trace() {
    let given = |key: &str| std::env::var_os(key).map(PathBuf::from);
    let Some(dir) = given("PARITY_TRACE") else { return a_traced_training_is_that_training() };
    let [request, capture] = ["PARITY_REQUEST", "PARITY_CAPTURE"].map(|key| given(key).expect(key));
    let request: Request = serde_json::from_slice(&std::fs::read(request).unwrap()).unwrap();
    trace(&dir, &request, &Dataset::load(Capture::open(&capture).unwrap(), 1).unwrap());
}

/// Without a requested trace: describing steps changes none of them.
fn a_traced_training_is_that_training() {
    let (_capture, dataset) = dataset(TestScene::default());
    let params = json!({ "method": "deformable3dgs", "iterations": { "warm-up": 3, "all": 5 },
        "density": { "from": 1, "interval": 2, "gradient_threshold": 1e-9 }, "curve": { "points": 1 },
        "deformable3dgs": { "network": { "depth": 2, "width": 8, "skip_after": 1 } } });
    let request: Request =
        serde_json::from_value(json!({ "params": params, "steps": 8, "noise": ["split"], "uniform": [] })).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let traced = trace(dir.path(), &request, &dataset);
    let params = resolve_for(request.params.clone(), &dataset.capture).unwrap();
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    (0..request.steps).for_each(|_| trainer.advance().unwrap());
    assert_eq!(trainer.state.save(), traced);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 10, "the scene, the start and eight steps");
}

/// Writes a training step by step; returns its last state.
fn trace(dir: &Path, request: &Request, dataset: &Dataset) -> (SavedState, Tensors) {
    let params = resolve_for(request.params.clone(), &dataset.capture).unwrap();
    let mut trainer = Trainer::new(dataset, &NOTHING, &params).unwrap();
    trainer.setup.samples_influence = false;
    write_scene(dir, &trainer);
    let write = |step: u64, trainer: &Trainer<'_>, (mut of_step, facts): (Tensors, Value)| {
        let (saved, tensors) = trainer.state.save();
        of_step.extend(tensors);
        let metadata = json!({ "after": saved, "step": facts }).to_string();
        let bytes = write_tensors(&of_step, Some(("trace", metadata))).unwrap();
        std::fs::write(dir.join(format!("{step:05}.safetensors")), bytes).unwrap();
    };
    write(0, &trainer, (Tensors::new(), Value::Null));
    for step in 1..=request.steps {
        let before = trainer.state.clone();
        let of_step = describe_next(&mut trainer, request);
        trainer.state = before;
        trainer.advance().unwrap();
        write(step, &trainer, of_step);
    }
    trainer.state.save()
}

/// Gradients, draws, losses, views and learning rates of the next step. Afterwards, the trainer's state is that in the
/// middle of the step.
fn describe_next(trainer: &mut Trainer<'_>, request: &Request) -> (Tensors, Value) {
    let mut sampler = trainer.state.sampler.clone();
    let views: Vec<usize> = (0..trainer.setup.params.shared.batch).map(|_| sampler.next_view()).collect();
    let mut tape = Tape::new(trainer.device);
    let (outcome, model) = trainer.differentiate(&mut tape).unwrap();
    let TrainState { phase, iteration, sh_degree, .. } = trainer.state;
    let rate = trainer.setup.learning_rates(phase);
    let rates: serde_json::Map<String, Value> =
        model.iter().filter_map(|(name, _)| Some((name.to_string(), rate(name)?.at(iteration).into()))).collect();
    let StepOutcome { gradients, .. } = &outcome;
    let mut tensors = Tensors::new();
    for (name, var) in model.iter() {
        let Some(gradient) = gradients.get(var) else { continue };
        let tensor = NamedTensor { shape: gradient.shape().to_vec(), values: gradient.as_slice().to_vec() };
        tensors.insert(format!("gradient.{name}"), tensor);
    }
    let mut random = trainer.setup.streams().step(trainer.phase_name(), iteration);
    let mut draw = |purpose: &String, normal: bool| {
        let draws = random.of(purpose.clone().leak());
        let draw = |_| if normal { StandardNormal.sample(draws) } else { draws.random::<f64>() as f32 };
        let values = (0..DRAWS).map(draw).collect();
        tensors.insert(format!("noise.{purpose}"), NamedTensor { shape: vec![DRAWS], values });
    };
    request.noise.iter().for_each(|purpose| draw(purpose, true));
    request.uniform.iter().for_each(|purpose| draw(purpose, false));
    let losses = outcome.read_back().0;
    let facts = json!({ "views": views, "losses": losses, "rates": rates, "phase": trainer.phase_name(),
        "iteration": iteration, "sh_degree": sh_degree });
    (tensors, facts)
}

fn write_scene(dir: &Path, trainer: &Trainer<'_>) {
    let dataset = trainer.setup.start.dataset;
    let scene = &dataset.scene;
    let views: Vec<Value> = dataset
        .train
        .iter()
        .map(|view| {
            let PinholeCamera { width, height, focal, center, rotation, translation } = view.camera;
            json!({ "time": view.time, "width": width, "height": height, "focal": focal, "center": center,
            "rotation": rotation, "translation": translation })
        })
        .collect();
    let images = dataset.train.iter().enumerate().map(|(at, view)| {
        let values = view.pixels.iter().map(|&value| f32::from(value) / 255.0).collect();
        (format!("image.{at:03}"), NamedTensor { shape: vec![view.camera.height, view.camera.width, 3], values })
    });
    let metadata = json!({ "params": trainer.setup.params, "views": views, "extent": scene.extent,
        "unit_world": scene.unit_world, "background": scene.background, "time_count": scene.time_count });
    let bytes = write_tensors(&images.collect(), Some(("scene", metadata.to_string()))).unwrap();
    std::fs::write(dir.join("scene.safetensors"), bytes).unwrap();
}
