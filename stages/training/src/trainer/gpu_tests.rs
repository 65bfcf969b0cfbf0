//! Training on a GPU against training on the CPU, and speculative against checked steps.

use std::collections::BTreeMap;

use serde_json::json;
use shaders::check::test_gpu;

use super::poison_tests::{Scene, all_effects};
use super::tests::{bits, dataset, params};
use super::*;
use crate::artifact::PhaseInfluence;
use crate::data::NOTHING;
use crate::method::Survey;
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;

/// Tolerance of a step's loss between devices, relative to the loss of the first step. Rounding errors grow from step
/// to step: Adam divides gradients by their magnitude, so the smallest ones count in full.
const LOSS: f64 = 0.01;
/// Tolerance of the final PSNR between devices, dB.
const PSNR: f64 = 0.1;

/// The result of a training.
struct Trained {
    losses: Vec<f64>,
    psnr: f64,
    influence: BTreeMap<String, PhaseInfluence>,
    model: Model,
}

/// Two hundred steps in two phases, with density control.
fn two_hundred_steps(rate: f64) -> TrainingParams {
    params(json!({
        "method": "deformable4dgs",
        "iterations": { "coarse": 80, "fine": 120 },
        "loss": { "lambda_dssim": 0.2 },
        "learning_rates": { "opacity": rate },
        "density": { "from": 20, "interval": 40, "prune_interval": 40, "gradient_threshold": 1e-6, "max_count": 200 },
        "curve": { "points": 2, "views": 2 },
        "deformable4dgs": { "channels": 4, "spatial_resolution": 6, "width": 8 },
    }))
}

/// Trains on a device and calls `change` before each step.
fn train_with(device: Device, rate: f64, mut change: impl FnMut(&mut Trainer)) -> anyhow::Result<Trained> {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = two_hundred_steps(rate);
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap().on(device);
    while !trainer.is_done() {
        change(&mut trainer);
        trainer.advance()?;
    }
    let Report { curve, influence, .. } = trainer.report();
    let psnr = curve.last().unwrap().psnr_val;
    Ok(Trained { losses: trainer.telemetry.losses.clone(), psnr, influence, model: trainer.finish()? })
}

fn train(device: Device, rate: f64) -> Trained {
    train_with(device, rate, |_| ()).unwrap()
}

/// A description of the difference between two trainings; `None` within the tolerances.
fn difference(found: &Trained, expected: &Trained) -> Option<String> {
    let errors = found.losses.iter().zip(&expected.losses).map(|(found, expected)| (found - expected).abs());
    let (step, loss) = errors.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let psnr = (found.psnr - expected.psnr).abs();
    let is_same = loss <= LOSS * expected.losses[0] && psnr <= PSNR;
    (!is_same).then(|| format!("a loss differs by {loss} at step {step}, the PSNR by {psnr} dB"))
}

#[test]
fn two_hundred_gpu_steps_agree_with_the_cpu_and_repeat() {
    let Some(gpu) = test_gpu() else { return };
    let (on_cpu, on_gpu) = (train(Device::Cpu, 0.05), train(Device::Gpu(gpu), 0.05));
    assert_eq!(difference(&on_gpu, &on_cpu), None);
    assert_eq!(bits(&train(Device::Gpu(gpu), 0.05).model), bits(&on_gpu.model), "two runs on one adapter");
    // A learning rate that is 10 % higher is detected.
    assert!(difference(&train(Device::Gpu(gpu), 0.055), &on_cpu).is_some());
}

#[test]
fn surveys_agree_with_the_cpu() {
    let Some(gpu) = test_gpu() else { return };
    let (_dir, dataset) = dataset(TestScene::default());
    let params = two_hundred_steps(0.05);
    let measure = |device: Device, survey: Survey| {
        Trainer::new(&dataset, &NOTHING, &params).unwrap().on(device).survey(survey).unwrap()
    };
    let errors = |by_loss| Survey::HighError { views: 3, above: 0.2, by_loss };
    for survey in [Survey::Sensitivity { views: 3 }, errors(false), errors(true)] {
        let (on_cpu, on_gpu) = (measure(Device::Cpu, survey), measure(Device::Gpu(gpu), survey));
        let largest = on_cpu.iter().copied().fold(0.0, f32::max);
        assert!(largest > 0.0 && on_gpu.len() == on_cpu.len(), "{survey:?}");
        // Rounding may move a pixel across the threshold of high errors.
        let agree = |(gpu, cpu): (&f32, &f32)| (gpu - cpu).abs() <= 0.02 * largest;
        assert!(on_gpu.iter().zip(&on_cpu).all(agree), "{survey:?}: {on_gpu:?} {on_cpu:?}");
    }
}

#[test]
fn speculative_and_checked_steps_agree() {
    let Some(gpu) = test_gpu() else { return };
    let checked = train_with(Device::Gpu(gpu), 0.05, |trainer| trainer.capacity = 0).unwrap();
    // Two overflows, each of which rolls back and replays.
    let (mut most_pending, mut overflows) = (0, 0);
    let speculative = train_with(Device::Gpu(gpu), 0.05, |trainer| {
        most_pending = most_pending.max(trainer.pending_steps());
        if trainer.steps().0 % 80 == 70 {
            overflows += 1;
            trainer.capacity = 30;
        }
    });
    let speculative = speculative.unwrap();
    assert!(most_pending > 20 && overflows == 2, "{most_pending} {overflows}");
    assert_eq!(speculative.losses, checked.losses);
    assert_eq!(speculative.influence, checked.influence);
    assert_eq!(bits(&speculative.model), bits(&checked.model));
}

#[test]
fn a_speculative_step_reports_the_same_failure_as_a_checked_one() {
    let Some(gpu) = test_gpu() else { return };
    for (tensor, phase_step) in [("gaussians.positions", 27), ("network.trunk.bias", 5)] {
        let poisoned = |is_checked: bool| {
            let failure = train_with(Device::Gpu(gpu), 0.05, |trainer| {
                if is_checked {
                    trainer.capacity = 0;
                }
                let has_tensor = trainer.state.optimizer.tensor(tensor).is_ok();
                if has_tensor && trainer.state.iteration == phase_step {
                    trainer.drain().unwrap();
                    trainer.state.optimizer.edit(tensor, |values| values[0] = f32::NAN).unwrap();
                }
            });
            format!("{:#}", failure.err().expect("a training that ends"))
        };
        let (speculative, checked) = (poisoned(false), poisoned(true));
        assert_eq!(speculative, checked);
        let iteration = format!("iteration {}", phase_step + 1);
        assert!(speculative.contains(&iteration) && speculative.contains(tensor), "{speculative}");
    }
}

/// Thirty steps with anchors that are added and removed.
fn anchors_that_grow() -> TrainingParams {
    let mut params = all_effects("modecgs");
    params.shared.iterations = [("coarse", 12), ("fine", 18)].map(|(name, steps)| (name.to_owned(), steps)).into();
    let density = &mut params.shared.density;
    (density.from, density.until, density.interval, density.gradient_threshold) = (3, 25, 5, 1e-7);
    density.max_count = 200;
    params
}

/// The losses and the model of a training of anchors, which is saved and resumed after `interrupted_after` steps.
fn train_anchors(scene: &Scene, device: Device, interrupted_after: Option<u64>) -> (Vec<f64>, Model) {
    let params = anchors_that_grow();
    let mut trainer = Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap().on(device);
    while !trainer.is_done() {
        trainer.advance().unwrap();
        if interrupted_after == Some(trainer.steps().0) {
            let checkpoint = trainer.checkpoint().unwrap();
            trainer = Trainer::resume(&scene.dataset, &scene.supplements, &params, checkpoint).unwrap().on(device);
        }
    }
    trainer.drain().unwrap();
    (trainer.telemetry.losses.clone(), trainer.finish().unwrap())
}

#[test]
fn anchors_grow_repeat_and_resume_on_a_gpu() {
    let Some(gpu) = test_gpu() else { return };
    let scene = Scene::new();
    let (on_cpu, _) = train_anchors(&scene, Device::Cpu, None);
    let (losses, undisturbed) = train_anchors(&scene, Device::Gpu(gpu), None);
    let until_growth = on_cpu.iter().zip(&losses).take(5);
    for (step, (cpu, gpu)) in until_growth.enumerate() {
        assert!((cpu - gpu).abs() <= LOSS * on_cpu[0], "step {step}: {gpu} for {cpu}");
    }
    let anchors = |model: &Model| model.tensors["anchors.features"].shape[0];
    assert!(anchors(&undisturbed) > 12, "no anchor grew");
    for interrupted_after in [None, Some(8), Some(12), Some(14)] {
        let (_, model) = train_anchors(&scene, Device::Gpu(gpu), interrupted_after);
        assert_eq!(bits(&model), bits(&undisturbed), "interrupted after {interrupted_after:?} steps");
    }
}
