use std::collections::BTreeSet;

use scene::TimeMap;
use shaders::check;
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::sub;
use shaders::tape::{Device, Tensor};

use super::*;
use crate::data::{Dataset, NOTHING, Streams};
use crate::effects::Effects;
use crate::scene_tests::TestScene;

fn scene_facts() -> SceneFacts {
    let time_map = TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 };
    SceneFacts { extent: 2.0, unit_world: 1.0, time_map, background: [1.0; 3], time_count: 9 }
}

fn base_of(settings: &HexplaneSettings) -> HexplaneGaussians {
    HexplaneGaussians::new(&HexplaneSettings::shared_defaults(), settings.clone())
}

/// A model at the start of `fine` on a few points.
fn fine_model(settings: &HexplaneSettings) -> (HexplaneGaussians, ModelState<f64>) {
    fine_model_of(base_of(settings))
}

fn fine_model_of(base: HexplaneGaussians) -> (HexplaneGaussians, ModelState<f64>) {
    let positions: Vec<[f32; 3]> = (0..6).map(|at| [at as f32, (at * at % 5) as f32, (at % 3) as f32 - 1.0]).collect();
    let points = PointCloud { colors: vec![[10, 200, 90]; positions.len()], positions };
    let state = begin(&base, &points);
    let state = enter_fine(&base, state);
    (base, state)
}

/// The views of the test scene with the scene facts of these tests.
fn dataset() -> Dataset {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(TestScene::default().write(dir.path()), 1).unwrap();
    Dataset { scene: scene_facts(), ..dataset }
}

/// The state at the start of `coarse`.
fn begin(base: &HexplaneGaussians, points: &PointCloud) -> ModelState<f64> {
    let dataset = dataset();
    let start = Start { dataset: &dataset, supplements: &NOTHING };
    base.initialize(&start, points, Streams::new(3)).unwrap()
}

fn enter_fine(base: &HexplaneGaussians, coarse: ModelState<f64>) -> ModelState<f64> {
    let dataset = dataset();
    let start = Start { dataset: &dataset, supplements: &NOTHING };
    base.enter_phase(FINE, coarse, &start, Streams::new(3)).unwrap()
}

fn camera() -> PinholeCamera {
    dataset().train[0].camera
}

/// Every attribute at a time in a phase.
fn attributes(base: &HexplaneGaussians, state: &ModelState<f64>, phase: &str, time: f64) -> Vec<Tensor<f64>> {
    let (scene, camera) = (scene_facts(), camera());
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let moment = Moment { scene: &scene, phase, time, camera: &camera, sh_degree: 2, left_out: None };
    let splats = base.splats(&mut tape, &model, &moment).unwrap();
    let SplatVars { positions, shape, opacity_logits, sh } = splats;
    let (log_scales, rotations) = shape.scales_and_rotations().unwrap();
    [positions, log_scales, rotations, opacity_logits, sh].map(|var| tape.value(var).clone()).to_vec()
}

#[test]
fn zero_heads_move_nothing() {
    let (base, state) = fine_model(&HexplaneSettings { zero_heads: true, ..HexplaneSettings::tiny() });
    let canonical = attributes(&base, &state, COARSE, 0.0);
    for time in [0.0, 0.37, 1.0] {
        assert_eq!(attributes(&base, &state, FINE, time), canonical, "time {time}");
    }
    // A planted fault: random heads must be detected as motion.
    let (base, state) = fine_model(&HexplaneSettings::tiny());
    assert_ne!(attributes(&base, &state, FINE, 0.37), attributes(&base, &state, COARSE, 0.37));
}

#[test]
fn time_planes_start_without_change() {
    let (base, state) = fine_model(&HexplaneSettings::tiny());
    let at = |time| attributes(&base, &state, FINE, time);
    for (first, second) in at(0.1).iter().zip(&at(0.9)) {
        check::agree(first, second, 1e-12).unwrap();
    }
}

#[test]
fn displacements_are_in_units_of_the_scene() {
    let (base, state) = fine_model(&HexplaneSettings::tiny());
    let points = state.get("gaussians.positions").unwrap();
    let displacements = |unit_world: f64| {
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let at = tape.constant(points.clone());
        let scene = SceneFacts { unit_world, ..scene_facts() };
        let moved = base.move_points(&mut tape, &model, &scene, at, 0.37).positions;
        let change = sub(&mut tape, moved, at);
        tape.value(change).clone().into_vec()
    };
    let (published, tiny) = (displacements(1.0), displacements(0.01));
    assert!(published.iter().any(|&change| change.abs() > 1e-3), "the network moves points: {published:?}");
    for (published, tiny) in published.iter().zip(&tiny) {
        assert!((0.01 * published - tiny).abs() <= 1e-9, "{published} {tiny}");
    }
}

#[test]
fn heads_that_are_off_have_no_parameters() {
    let heads = Heads { position: true, ..Heads::NONE };
    let (_, state) = fine_model(&HexplaneSettings { heads, ..HexplaneSettings::tiny() });
    let names: Vec<&str> = state.names().filter(|name| belongs(name, network::NETWORK)).collect();
    assert_eq!(names.len(), 6, "{names:?}");
}

#[test]
fn without_motion_fine_continues_like_coarse() {
    let shared = Shared { effects: Effects::Named(BTreeSet::new()), ..HexplaneSettings::shared_defaults() };
    let base = HexplaneGaussians::new(&shared, HexplaneSettings::tiny());
    let points = PointCloud { positions: vec![[0.0; 3], [1.0; 3]], colors: vec![[9; 3]; 2] };
    let coarse = begin(&base, &points);
    let fine = enter_fine(&base, coarse.clone());
    assert_eq!(fine, coarse);
    assert_eq!(attributes(&base, &fine, FINE, 0.7), attributes(&base, &fine, COARSE, 0.7));
}

#[test]
fn points_move_like_gaussians() {
    let settings = HexplaneSettings::tiny();
    let (base, state) = fine_model(&settings);
    let (extended, with_head) = fine_model_of(base_of(&settings).with_further_heads(vec![("velocity", 3)]));
    let of_head = |name: &str| name.starts_with("network.velocity");
    assert_eq!(with_head.names().filter(|name| of_head(name)).count(), 4);
    assert!(state.iter().eq(with_head.iter().filter(|(name, _)| !of_head(name))));

    let mut tape = Tape::new(Device::Cpu);
    let model = with_head.bind(&mut tape, |_| false);
    let points = extended.move_points(&mut tape, &model, &scene_facts(), model.get("gaussians.positions"), 0.4);
    assert_eq!(*tape.value(points.positions), attributes(&base, &state, FINE, 0.4)[0]);
    let velocity = extended.further_head(&mut tape, &model, &scene_facts(), "velocity", points.hidden);
    assert_eq!(*tape.value(velocity), Tensor::zeros([6, 3]), "a further head starts at zero");
}

#[test]
fn time_texels_follow_the_training_times_and_the_axis() {
    let time_texels = |settings: HexplaneSettings| fine_model(&settings).1.get("field.plane_0_xt").unwrap().rows();
    // 9 times: 5 texels in the published counting, of which the full axis needs 3.
    assert_eq!(time_texels(HexplaneSettings::tiny()), 3);
    assert_eq!(time_texels(HexplaneSettings { time_axis: TimeAxis::UpperHalf, ..HexplaneSettings::tiny() }), 5);
    assert_eq!(time_texels(HexplaneSettings { time_resolution: Some(75), ..HexplaneSettings::tiny() }), 38);
}

#[test]
fn invalid_settings_are_refused() {
    assert!(HexplaneSettings::default().check().keys().is_empty());
    let bad = [
        ("multipliers", HexplaneSettings { multipliers: Vec::new(), ..HexplaneSettings::default() }),
        ("channels", HexplaneSettings { channels: 0, ..HexplaneSettings::default() }),
        ("heads", HexplaneSettings { heads: Heads::NONE, ..HexplaneSettings::default() }),
        ("time_to_one", HexplaneSettings { time_to_one: f64::NAN, ..HexplaneSettings::default() }),
    ];
    bad.iter().for_each(|(key, settings)| assert_eq!(settings.check().keys(), [*key]));
}
