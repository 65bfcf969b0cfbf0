use serde_json::to_value;

use super::*;
use crate::data::Streams;
use crate::short_training_tests::ShortTraining;

fn train(effects: &[&str]) -> ShortTraining {
    ShortTraining::run(Scgs::NAME, to_value(Scgs::tiny_settings()).unwrap(), effects)
}

#[test]
fn without_motion_there_are_no_nodes_and_no_network() {
    let (moving, still) = (train(&["motion"]), train(&[]));
    assert!(moving.count_tensors("network.") > 0 && moving.count_tensors("nodes.") == 4);
    assert!(moving.tensors.contains("gaussians.node_features") && moving.count_tensors("candidates.") == 0);
    assert!(["network.", "nodes.", "candidates."].iter().all(|prefix| still.count_tensors(prefix) == 0));
    assert!(!still.tensors.contains("gaussians.node_features"));
    let added = ["neighbor_weights", "blend_frames", "neighbor_blend", "linear", "changed_log_scale"];
    assert!(added.iter().all(|operation| moving.ran(operation) && !still.ran(operation)), "{:?}", still.operations);
    assert_eq!(train(&["arap"]).checkpoint, still.checkpoint);
}

#[test]
fn rigidity_adds_operations_but_no_tensors() {
    let (free, rigid) = (train(&["motion"]), train(&["motion", "arap"]));
    assert_eq!(free.tensors, rigid.tensors);
    assert!(rigid.ran("quaternion_rotate") && !free.ran("quaternion_rotate"));
    assert_ne!(free.checkpoint, rigid.checkpoint);
}

#[test]
fn untrained_nodes_barely_move_the_gaussians() {
    let mut state = ModelState::<f64>::new();
    let nodes = Nodes::new(&Scgs::tiny_settings());
    let random = Streams::new(1);
    let points = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 20, 1);
    nodes.insert_network(&mut state, &points, random);
    let scene = crate::data::SceneFacts {
        extent: 3.0,
        unit_world: 1.0,
        time_map: scene::TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
        background: [0.0; 3],
        time_count: 10,
    };
    candidates::insert(&mut state, &scene, &points, 20, 0).unwrap();
    let mut state = nodes.choose(state).unwrap();
    gaussians::insert_gaussians(&mut state, GAUSSIANS, &points, 0, 0.01).unwrap();
    nodes.insert_gaussian_features(&mut state).unwrap();
    let mut tape = Tape::new(shaders::tape::Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let canonical = gaussians::static_splats(&mut tape, &model, GAUSSIANS, 0);
    let carried = nodes.carry(&mut tape, &model, canonical, None, 0.4);
    let distance = |(a, b): (&f64, &f64)| (a - b).abs();
    let (before, after) = (tape.value(canonical.positions).as_slice(), tape.value(carried.positions).as_slice());
    let farthest = before.iter().zip(after).map(distance).fold(0.0, f64::max);
    assert!(farthest > 0.0 && farthest <= 1e-2, "{farthest}");
}
