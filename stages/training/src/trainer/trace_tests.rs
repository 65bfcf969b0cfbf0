//! A training step by step in files, for other programs to compare with (`tests/parity`).
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

use super::train_state::TrainState;
use super::*;
use crate::artifact::{NamedTensor, write_tensors};
use crate::data::{Dataset, NOTHING};
use crate::method::StepOutcome;
use crate::params::TrainingParams;
use crate::planning::resolve_for;

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
#[ignore = "a tool: tests/parity reads the files that it writes"]
fn write_trace() {
    let path = |key: &str| PathBuf::from(std::env::var_os(key).unwrap_or_else(|| panic!("{key} is not set")));
    let dir = path("PARITY_TRACE");
    let request: Request = serde_json::from_slice(&std::fs::read(path("PARITY_REQUEST")).unwrap()).unwrap();
    let capture = Capture::open(&path("PARITY_CAPTURE")).unwrap();
    let params = resolve_for(request.params.clone(), &capture).unwrap();
    let dataset = Dataset::load(capture, 1).unwrap();
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    trainer.setup.samples_influence = false;
    write_scene(&dir, &trainer);
    let write = |step: u64, trainer: &Trainer<'_>, (mut of_step, facts): (Tensors, Value)| {
        let (saved, tensors) = trainer.state.save();
        of_step.extend(tensors);
        let metadata = json!({ "after": saved, "step": facts }).to_string();
        std::fs::write(
            dir.join(format!("{step:05}.safetensors")),
            write_tensors(&of_step, Some(("trace", metadata))).unwrap(),
        )
        .unwrap();
    };
    write(0, &trainer, (Tensors::new(), Value::Null));
    for step in 1..=request.steps {
        let before = trainer.state.clone();
        let of_step = describe_next(&mut trainer, &request);
        trainer.state = before;
        trainer.advance().unwrap();
        write(step, &trainer, of_step);
    }
}

/// Gradients, draws, losses, views and learning rates of the next step. The trainer's state is that amid the step.
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
