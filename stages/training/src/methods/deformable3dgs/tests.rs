use serde_json::{Value, to_value};

use super::*;
use crate::short_training_tests::ShortTraining;

fn train(effects: &[&str]) -> ShortTraining {
    ShortTraining::run(Deformable3dgs::NAME, tiny(), effects)
}

fn tiny() -> Value {
    to_value(Deformable3dgs::tiny_settings()).unwrap()
}

#[test]
fn without_motion_no_network_is_trained() {
    let (moving, still) = (train(&["motion"]), train(&[]));
    assert!(moving.count_tensors("network.") > 0 && moving.ran("positional_encoding"));
    assert_eq!(still.count_tensors("network."), 0);
    assert_eq!(still.tensors.len() + moving.count_tensors("network."), moving.tensors.len());
    let added =
        ["linear", "positional_encoding", "concat_columns", "quaternion_normalize", "changed_log_scale", "gather"];
    assert!(added.iter().all(|operation| moving.ran(operation) && !still.ran(operation)), "{:?}", still.operations);
    let noisy_but_still = train(&["time-noise"]);
    assert_eq!(noisy_but_still.checkpoint, still.checkpoint);
}

#[test]
fn time_noise_changes_the_result_without_extra_operations() {
    let (plain, noisy) = (train(&["motion"]), train(&["motion", "time-noise"]));
    assert_eq!((&plain.tensors, &plain.operations), (&noisy.tensors, &noisy.operations));
    assert_ne!(plain.checkpoint, noisy.checkpoint);
}

#[test]
fn both_phases_share_one_schedule() {
    let shared = Deformable3dgs::shared_defaults();
    let method = Deformable3dgs::build::<f32>(&shared, Settings::default());
    let scene = crate::data::SceneFacts {
        extent: 3.0,
        unit_world: 1.0,
        time_map: scene::TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
        background: [0.0; 3],
        time_count: 10,
    };
    let rate = |phase, tensor| method.learning_rate(phase, tensor, &scene).unwrap();
    let (first, rest) = (rate(WARM_UP, "gaussians.positions"), rate(ALL, "gaussians.positions"));
    assert!((first.start / 8e-4 - 1.0).abs() <= 1e-12 && (first.at(3500) / rest.at(500) - 1.0).abs() <= 1e-12);
    let network = rate(ALL, "network.hidden.0.weight");
    assert!((network.at(37_000) / 1.6e-6 - 1.0).abs() <= 1e-12 && network.at(0) < 8e-4);
}
