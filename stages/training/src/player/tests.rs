use std::sync::atomic::Ordering;

use serde_json::json;
use shaders::arrays::bytes::{Bytes, to_bytes};
use shaders::check::test_gpu;

use super::*;
use crate::data::{Dataset, NOTHING};
use crate::scene_tests::TestScene;
use crate::trainer::Trainer;

/// A model after a few steps, and the moments of two views.
fn trained() -> (Model, Vec<(f64, PinholeCamera)>) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(TestScene::default().write(dir.path()), 2).unwrap();
    let table = json!({ "method": "static3dgs", "iterations": { "train": 3 }, "curve": { "points": 0 } });
    let params = TrainingParams::from_table(table.as_object().unwrap().clone()).unwrap();
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let views = dataset.curve.iter().map(|view| &dataset.capture.views[view.index]).take(2);
    (trainer.finish().unwrap(), views.map(|view| (view.time_secs, PinholeCamera::from(&view.camera))).collect())
}

fn devices() -> impl Iterator<Item = Device> {
    [Some(Device::Cpu), test_gpu().map(Device::Gpu)].into_iter().flatten()
}

#[test]
fn frames_equal_renders_even_without_capacity() {
    let (model, moments) = trained();
    for device in devices() {
        let player = Player::new(&model).unwrap().on(device);
        let expected: Vec<_> =
            moments.iter().map(|(time, camera)| to_bytes(&player.render(*time, camera).unwrap())).collect();
        let is_constant = |bytes: &Bytes| bytes.values.iter().all(|value| *value == bytes.values[0]);
        assert!(expected.iter().all(|bytes| bytes.are_finite && !is_constant(bytes)));
        for capacity in [player.capacity.load(Ordering::Relaxed), 1] {
            player.capacity.store(capacity, Ordering::Relaxed);
            let started: Vec<_> =
                moments.iter().map(|(time, camera)| player.start_frame(*time, camera).unwrap()).collect();
            started.iter().for_each(StartedFrame::wait);
            let found: Vec<_> = started.into_iter().map(|frame| player.finish_frame(frame).unwrap()).collect();
            assert_eq!(found, expected, "capacity {capacity} on {}", device.name());
        }
    }
}

#[test]
fn a_splat_that_is_not_finite_is_an_error() {
    let (mut model, moments) = trained();
    let positions = model.tensors.get_mut("gaussians.positions").unwrap();
    positions.values[0] = f32::NAN;
    let (time, camera) = &moments[0];
    for device in devices() {
        let player = Player::new(&model).unwrap().on(device);
        // The first render of each kind overflows, and its repetition does not count the splat again.
        player.capacity.store(1, Ordering::Relaxed);
        let rendered = player.render(*time, camera);
        player.capacity.store(1, Ordering::Relaxed);
        let frame = player.start_frame(*time, camera).and_then(|frame| {
            frame.wait();
            player.finish_frame(frame)
        });
        for error in [rendered.unwrap_err(), frame.unwrap_err()] {
            assert_eq!(error.to_string(), "a value of 1 splats is not finite", "{}", device.name());
        }
    }
}
