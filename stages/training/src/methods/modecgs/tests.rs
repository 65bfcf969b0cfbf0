use shaders::check;
use shaders::pointwise::sub;
use shaders::rasteriser::ShapeVars;
use shaders::tape::Device;

use super::*;
use crate::bases::anchors::COARSE;
use crate::data::{Dataset, NOTHING, Streams};
use crate::effects::Effects;
use crate::scene_tests::TestScene;

/// The method and its state at the start of `fine` on the test scene.
fn at_fine(effects: Effects, settings: Settings) -> (MotionDecomposition, ModelState<f64>, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(TestScene::default().write(dir.path()), 1).unwrap();
    let method = MotionDecomposition::new(&Shared { effects, ..Modecgs::shared_defaults() }, settings);
    let start = Start { dataset: &dataset, supplements: &NOTHING };
    let points = dataset.capture.load_points().unwrap().unwrap();
    let random = Streams::new(5);
    let mut state = method.initialize(&start, &points, random).unwrap();
    for phase in [COARSE, FINE] {
        state = method.enter_phase(phase, state, &start, random).unwrap();
    }
    (method, state, dataset)
}

/// The positions of the Gaussians and the number of operations that compute them.
fn positions(
    method: &MotionDecomposition,
    state: &ModelState<f64>,
    dataset: &Dataset,
    phase: &str,
    time: f64,
) -> (Tensor<f64>, usize) {
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let moment =
        Moment { scene: &dataset.scene, phase, time, camera: &dataset.train[0].camera, sh_degree: 0, left_out: None };
    let splats = method.gaussians(&mut tape, &model, &moment).splats;
    let operations = tape.profile().ops.values().map(|cost| cost.forward.calls as usize).sum();
    (tape.value(splats.positions).clone(), operations)
}

#[test]
fn only_nonzero_heads_move_gaussians_initially() {
    let zero = Settings {
        deformation: DeformationSettings { zero_heads: true, ..DeformationSettings::tiny() },
        ..Modecgs::tiny_settings()
    };
    let (method, state, dataset) = at_fine(Effects::Auto, zero);
    let (still, _) = positions(&method, &state, &dataset, COARSE, 0.0);
    for time in [0.0, 0.4, 1.0] {
        check::agree(&positions(&method, &state, &dataset, FINE, time).0, &still, 1e-12).unwrap();
    }
    let (method, state, dataset) = at_fine(Effects::Auto, Modecgs::tiny_settings());
    let (still, _) = positions(&method, &state, &dataset, COARSE, 0.0);
    let (moved, _) = positions(&method, &state, &dataset, FINE, 0.4);
    assert!(moved.shape() != still.shape() || check::agree(&moved, &still, 1e-3).is_err());
}

#[test]
fn displacements_are_in_units_of_the_scene() {
    let (method, state, dataset) = at_fine(Effects::Auto, Modecgs::tiny_settings());
    let displacements = |unit_world: f64| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let positions = model.get("anchors.positions");
        let scene = SceneFacts { unit_world, ..dataset.scene.clone() };
        let global = method.global.at(&mut tape, &model, &scene, positions, 0.3).positions;
        let count = tape.value(positions).rows();
        let mut ones = |columns: usize| tape.constant(Tensor::full([count, columns], 1.0));
        let shape = ShapeVars::ScaleRotation { log_scales: ones(3), rotations: ones(4) };
        let spawned = SplatVars { positions, shape, opacity_logits: ones(1), sh: ones(3) };
        let moved = method.local.deform(&mut tape, &model, &scene, spawned, 0.3).positions;
        let local = sub(&mut tape, moved, positions);
        [global, local].map(|change| tape.value(change).clone().into_vec())
    };
    for (published, tiny) in displacements(1.0).iter().zip(displacements(0.01)) {
        assert!(published.iter().any(|change| change.abs() > 1e-3), "the network moves points: {published:?}");
        for (published, tiny) in published.iter().zip(&tiny) {
            assert!((0.01 * published - tiny).abs() <= 1e-9, "{published} {tiny}");
        }
    }
}

#[test]
fn without_motion_no_tensors_or_operations_are_added() {
    let none = Effects::Named(Default::default());
    let (method, state, dataset) = at_fine(none, Modecgs::tiny_settings());
    let is_static = |name: &str| name.starts_with("anchors.") && name != GATES || name.starts_with("views.");
    assert!(state.names().all(is_static), "{:?}", state.names().collect::<Vec<_>>());
    let (fine, in_fine) = positions(&method, &state, &dataset, FINE, 0.7);
    let (coarse, in_coarse) = positions(&method, &state, &dataset, COARSE, 0.0);
    assert_eq!((fine, in_fine), (coarse, in_coarse));
    let (method, state, dataset) = at_fine(Effects::Auto, Modecgs::tiny_settings());
    assert!(positions(&method, &state, &dataset, FINE, 0.7).1 > in_coarse, "motion adds operations");
}

#[test]
fn position_gates_are_binary_and_other_gates_soft() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let mut constant = |columns: usize, value: f64| tape.constant(Tensor::full([2, columns], value));
    let canonical = Anchors {
        positions: constant(3, 1.0),
        features: constant(2, 1.0),
        offsets: constant(3, 1.0),
        log_scales: constant(6, 1.0),
    };
    let change = AnchorChange {
        positions: constant(3, 2.0),
        features: constant(2, 2.0),
        offsets: constant(3, 2.0),
        log_scales: constant(6, 2.0),
    };
    let gates = tape.leaf(Tensor::from_vec([2, 2], vec![-6.0, 0.0, -3.0, 30.0]));
    let moved = through_gates(&mut tape, gates, &canonical, &change);
    check::agree(tape.value(moved.positions), &Tensor::from_vec([2, 3], vec![1.0, 1.0, 1.0, 3.0, 3.0, 3.0]), 1e-12)
        .unwrap();
    check::agree(tape.value(moved.features), &Tensor::from_vec([2, 2], vec![2.0, 2.0, 3.0, 3.0]), 1e-12).unwrap();
    let gradient = tape.backward(&[(moved.positions, Tensor::full([2, 3], 1.0))]).take(gates).unwrap();
    assert!(gradient.row(0)[0] > 0.0, "a closed gate learns to open");
}

#[test]
fn times_of_a_segment_map_to_its_start() {
    let (method, ..) = at_fine(Effects::Auto, Modecgs::tiny_settings());
    for (time, start) in [(0.0, 0.0), (0.12, 0.0), (0.13, 0.125), (0.999, 0.875), (1.0, 0.875)] {
        assert_eq!(method.segment_time(time), start);
    }
}
