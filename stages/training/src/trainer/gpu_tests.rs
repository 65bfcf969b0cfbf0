//! A training on a GPU is the training on the CPU, but for rounding.

use serde_json::json;
use shaders::check::test_gpu;

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

/// Two hundred steps in two phases, with density control, on a device.
fn train(device: Device, rate: f64) -> Trained {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = params(json!({
        "method": "deformable4dgs",
        "iterations": { "coarse": 80, "fine": 120 },
        "loss": { "lambda_dssim": 0.2 },
        "learning_rates": { "opacity": rate },
        "density": { "from": 20, "interval": 40, "prune_interval": 40, "gradient_threshold": 1e-6, "max_count": 200 },
        "curve": { "points": 2, "views": 2 },
        "deformable4dgs": { "channels": 4, "spatial_resolution": 6, "width": 8 },
    }));
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap().on(device);
    let mut losses = Vec::new();
    while !trainer.is_done() {
        trainer.advance().unwrap();
        losses.push(trainer.loss);
    }
    let psnr = trainer.report().curve.last().unwrap().psnr_val;
    Trained { losses, psnr, model: trainer.finish().unwrap() }
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
