use serde_json::to_value;
use shaders::check::noise;
use shaders::tape::{Device, Tensor};

use super::*;
use crate::bases::control_nodes::SETTLE_NODES;
use crate::data::{Dataset, NOTHING, Streams};
use crate::scene_tests::TestScene;
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
fn candidates_see_random_backgrounds_where_the_coverage_is_known() {
    let on = |with_coverage: bool| {
        let scene = TestScene { size: 16, with_coverage, ..TestScene::default() };
        ShortTraining::run_on(scene, Scgs::NAME, to_value(Scgs::tiny_settings()).unwrap(), &["motion"])
    };
    let (known, unknown) = (on(true), on(false));
    assert_eq!(known.tensors, unknown.tensors);
    assert_ne!(known.checkpoint, unknown.checkpoint);
}

#[test]
fn time_noise_changes_the_result() {
    assert_ne!(train(&["motion", "time-noise"]).checkpoint, train(&["motion"]).checkpoint);
}

#[test]
fn rigidity_adds_operations_but_no_tensors() {
    let (free, rigid) = (train(&["motion"]), train(&["motion", "arap"]));
    assert_eq!(free.tensors, rigid.tensors);
    assert!(rigid.ran("quaternion_rotate") && !free.ran("quaternion_rotate"));
    assert_ne!(free.checkpoint, rigid.checkpoint);
}

/// A state at the start of [`ALL`], with nodes chosen among few candidates and Gaussians at the same points.
fn before_all(method: &dyn Method<f64>, test_scene: TestScene) -> (ModelState<f64>, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(test_scene.write(dir.path()), 1).unwrap();
    let start = Start { dataset: &dataset, supplements: &NOTHING };
    let points = dataset.initial_points(&Shared::default().initial_points, 0).unwrap();
    let random = Streams::new(1);
    let mut state = method.initialize(&start, &points, random).unwrap();
    for phase in method.phases() {
        state = method.enter_phase(phase.name, state, &start, random).unwrap();
    }
    (state, dataset)
}

#[test]
fn untrained_nodes_barely_move_the_gaussians() {
    let method = Scgs::build::<f64>(&Scgs::shared_defaults(), Scgs::tiny_settings());
    let (state, dataset) = before_all(&*method, TestScene::default());
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let camera = &dataset.train[0].camera;
    let moment = Moment { scene: &dataset.scene, phase: ALL, time: 0.4, camera, sh_degree: 0, left_out: None };
    let carried = method.splats(&mut tape, &model, &moment).unwrap();
    let distance = |(a, b): (&f64, &f64)| (a - b).abs();
    let [before, after] = [model.get("gaussians.positions"), carried.positions].map(|var| tape.value(var).as_slice());
    let farthest = before.iter().zip(after).map(distance).fold(0.0, f64::max);
    assert!(farthest > 0.0 && farthest <= 1e-2, "{farthest}");
}

#[test]
fn positions_of_nodes_are_constants_once_chosen() {
    let method = Scgs::build::<f64>(&Scgs::shared_defaults(), Scgs::tiny_settings());
    let (state, dataset) = before_all(&*method, TestScene::default());
    let rate = |phase, tensor| method.learning_rate(phase, tensor, &dataset.scene);
    assert!([WARM_UP, ALL].iter().all(|phase| rate(phase, "nodes.positions").is_none()));
    for learnt in ["nodes.log_radii", "nodes.gates", "nodes.features", "gaussians.node_features", "network.frame.bias"]
    {
        assert!(
            rate(ALL, learnt).is_some() && rate(WARM_UP, learnt).is_none() && state.get(learnt).is_ok(),
            "{learnt}"
        );
    }
    assert!(rate(SETTLE_NODES, "candidates.positions").is_some());
}

#[test]
fn the_schedule_of_the_network_restarts_with_the_gaussians() {
    let method = Scgs::build::<f64>(&Scgs::shared_defaults(), Settings::default());
    let (_, dataset) = before_all(&*method, TestScene::default());
    let first = |phase| method.learning_rate(phase, "network.hidden.0.weight", &dataset.scene).map(|law| law.at(0));
    let published = CoordinateMlpSettings::default().rate;
    for (phase, steps) in [("choose-nodes", 2000), (SETTLE_NODES, 7500), (ALL, 3000)] {
        assert!((first(phase).unwrap() / published.at(steps) - 1.0).abs() <= 1e-12, "{phase}");
    }
    assert!(first("place-candidates").is_none() && first(WARM_UP).is_none());
}

#[test]
fn motion_does_not_pull_on_the_positions_of_gaussians() {
    let method = Scgs::build::<f64>(&Scgs::shared_defaults(), Scgs::tiny_settings());
    let (mut state, dataset) = before_all(&*method, TestScene::default());
    // Frames far from the identity, so that a gradient through them would differ.
    let frame = state.get("network.frame.bias").unwrap().clone();
    state.insert("network.frame.bias", Tensor::from_vec(frame.shape(), vec![0.2, 0.9, -0.4, 0.3]));
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| true);
    let camera = &dataset.train[0].camera;
    let moment = Moment { scene: &dataset.scene, phase: ALL, time: 0.4, camera, sh_degree: 0, left_out: None };
    let carried = method.splats(&mut tape, &model, &moment).unwrap();
    let seed = Tensor::from_vec(tape.value(carried.positions).shape(), noise(tape.value(carried.positions).len(), 3));
    let gradients = tape.backward(&[(carried.positions, seed.clone())]);
    shaders::check::agree(gradients.get(model.get("gaussians.positions")).unwrap(), &seed, 1e-12).unwrap();
    assert!(gradients.get(model.get("nodes.log_radii")).is_some());
}
