//! The unit of length does not matter: from a scene with units thousands of times smaller, every method learns the same
//! images.

use serde_json::json;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Tensor;

use crate::data::Dataset;
use crate::params::TrainingParams;
use crate::player::Player;
use crate::scene_tests::TestScene;
use crate::trainer::Trainer;

/// Steps of every phase: few, because rounding grows to visible differences in deep networks.
const STEPS: u64 = 5;
/// The largest difference of a pixel's channel, in [0, 1]. The lengths differ by a power of two, so only logarithms of
/// lengths round differently.
const TOLERANCE: f32 = 0.01;

/// The first and the last validation view after a short training with every effect that the inputs support.
fn renders(method: &str, scale: f32) -> Vec<Tensor<f32>> {
    let dir = tempfile::tempdir().unwrap();
    let scene = TestScene { scale, ..TestScene::default() };
    let dataset = Dataset::load(scene.write(dir.path()), 2).unwrap();
    let supplements = scene.supplements(&dataset);
    let phases: Vec<String> = TrainingParams::of(method).unwrap().shared.iterations.keys().cloned().collect();
    let iterations: serde_json::Map<_, _> = phases.into_iter().map(|phase| (phase, json!(STEPS))).collect();
    let table = json!({ "method": method, "iterations": iterations, "curve": { "points": 0 } });
    let params = TrainingParams::from_table(table.as_object().unwrap().clone()).unwrap();
    let mut trainer = Trainer::new(&dataset, &supplements, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let player = Player::new(&trainer.finish().unwrap()).unwrap();
    let views = dataset.curve.iter().map(|view| &dataset.capture.views[view.index]);
    views.map(|view| player.render(view.time_secs, &PinholeCamera::from(&view.camera)).unwrap()).collect()
}

#[test]
fn the_unit_of_length_changes_no_image() {
    let mut differing = Vec::new();
    for method in super::NAMES.iter() {
        let [small, large] = [1.0 / 64.0, 64.0].map(|scale| renders(method, scale));
        let pixels =
            |images: &[Tensor<f32>]| images.iter().flat_map(|image| image.as_slice().to_vec()).collect::<Vec<_>>();
        let difference = pixels(&small).iter().zip(pixels(&large)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        if difference > TOLERANCE {
            differing.push(format!("{method}: {difference}"));
        }
    }
    assert!(differing.is_empty(), "{differing:?}");
}
