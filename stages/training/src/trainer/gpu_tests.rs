//! A training on a GPU is the training on the CPU, but for rounding.

use serde_json::json;
use shaders::check::test_gpu;

use super::poison::{Scene, all_effects};
use super::tests::{bits, dataset, params};
use super::*;
use crate::supplements::NOTHING;
use crate::test_scene::TestScene;

/// Largest difference of a step's loss from that of the other device, relative to the loss of the first step. Rounding
/// errors grow from step to step: Adam divides by the size of gradients, so that the smallest ones count in full.
const LOSS: f64 = 0.01;
/// Largest difference of the PSNR at the end, dB.
const PSNR: f64 = 0.1;

/// What a training came to.
struct Trained {
    losses: Vec<f64>,
    psnr: f64,
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

/// The training on a device, with a change of the trainer before each step.
fn train_with(device: Device, rate: f64, mut change: impl FnMut(&mut Trainer)) -> anyhow::Result<Trained> {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = two_hundred_steps(rate);
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap().on(device);
    while !trainer.is_done() {
        change(&mut trainer);
        trainer.advance()?;
    }
    let psnr = trainer.report().curve.last().unwrap().psnr_val;
    Ok(Trained { losses: trainer.every_loss.clone(), psnr, model: trainer.finish()? })
}

fn train(device: Device, rate: f64) -> Trained {
    train_with(device, rate, |_| ()).unwrap()
}

/// Why two trainings are not the same.
fn difference(found: &Trained, expected: &Trained) -> Option<String> {
    let errors = found.losses.iter().zip(&expected.losses).map(|(found, expected)| (found - expected).abs());
    let (step, loss) = errors.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let psnr = (found.psnr - expected.psnr).abs();
    let is_same = loss <= LOSS * expected.losses[0] && psnr <= PSNR;
    (!is_same).then(|| format!("a loss differs by {loss} at step {step}, the PSNR by {psnr} dB"))
}

#[test]
fn two_hundred_steps_agree_with_the_cpu_and_repeat_bit_by_bit() {
    let Some(gpu) = test_gpu() else { return };
    let (on_cpu, on_gpu) = (train(Device::Cpu, 0.05), train(Device::Gpu(gpu), 0.05));
    assert_eq!(difference(&on_gpu, &on_cpu), None);
    assert_eq!(bits(&train(Device::Gpu(gpu), 0.05).model), bits(&on_gpu.model), "two runs on one adapter");
    // A tenth more of one step size is noticed.
    assert!(difference(&train(Device::Gpu(gpu), 0.055), &on_cpu).is_some());
}

#[test]
fn a_gpu_that_goes_ahead_does_what_one_that_is_watched_does() {
    let Some(gpu) = test_gpu() else { return };
    let watched = train_with(Device::Gpu(gpu), 0.05, |trainer| trainer.room = 0).unwrap();
    // Now and then there is too little room, which is noticed, and the steps are made again.
    let (mut most_ahead, mut narrow) = (0, 0);
    let ahead = train_with(Device::Gpu(gpu), 0.05, |trainer| {
        most_ahead = most_ahead.max(trainer.steps_ahead());
        if trainer.steps().0 % 80 == 70 {
            narrow += 1;
            trainer.room = 30;
        }
    });
    let ahead = ahead.unwrap();
    assert!(most_ahead > 20 && narrow == 2, "{most_ahead} {narrow}");
    assert_eq!(ahead.losses, watched.losses);
    assert_eq!(bits(&ahead.model), bits(&watched.model));
}

#[test]
fn what_is_not_finite_ends_a_training_on_a_gpu_at_that_step_by_name() {
    let Some(gpu) = test_gpu() else { return };
    for (tensor, phase_step) in [("gaussians.positions", 27), ("network.trunk.bias", 5)] {
        let poisoned = |is_watched: bool| {
            let failure = train_with(Device::Gpu(gpu), 0.05, |trainer| {
                if is_watched {
                    trainer.room = 0;
                }
                let has_tensor = trainer.optimizer.tensor(tensor).is_ok();
                if has_tensor && trainer.iteration == phase_step {
                    trainer.settle().unwrap();
                    trainer.optimizer.edit(tensor, |values| values[0] = f32::NAN).unwrap();
                }
            });
            format!("{:#}", failure.err().expect("a training that ends"))
        };
        let (ahead, watched) = (poisoned(false), poisoned(true));
        assert_eq!(ahead, watched);
        assert!(ahead.contains(&format!("iteration {}", phase_step + 1)) && ahead.contains(tensor), "{ahead}");
    }
}

/// Thirty steps of anchors that come and go.
fn anchors_that_grow() -> TrainingParams {
    let mut params = all_effects("modecgs");
    params.shared.iterations = [("coarse", 12), ("fine", 18)].map(|(name, steps)| (name.to_owned(), steps)).into();
    let density = &mut params.shared.density;
    (density.from, density.until, density.interval, density.gradient_threshold) = (3, 25, 5, 1e-7);
    density.max_count = 200;
    params
}

/// The losses of a training of anchors, and its end; a checkpoint is taken and gone on from after so many steps.
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
    trainer.settle().unwrap();
    (trainer.every_loss.clone(), trainer.finish().unwrap())
}

#[test]
fn anchors_grow_on_a_gpu_and_a_training_of_them_repeats_and_resumes_bit_by_bit() {
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
        let (_, again) = train_anchors(&scene, Device::Gpu(gpu), interrupted_after);
        assert_eq!(bits(&again), bits(&undisturbed), "interrupted after {interrupted_after:?} steps");
    }
}
