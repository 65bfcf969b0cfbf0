use scene::cloud::PointCloud;
use serde_json::to_value;
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Tensor, Var};

use super::node_motion::NodeMotion;
use super::*;
use crate::bases::control_nodes::identity_rotations;
use crate::data::Streams;
use crate::scene_tests::{ANY_SCENE, moment};
use crate::short_training_tests::ShortTraining;

fn train(effects: &[&str]) -> ShortTraining {
    ShortTraining::run(Mcgs::NAME, to_value(Mcgs::tiny_settings()).unwrap(), effects)
}

fn scene(time_count: usize) -> SceneFacts {
    let time_map = scene::TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 };
    SceneFacts { extent: 3.0, unit_world: 1.0, time_map, background: [0.0; 3], time_count }
}

#[test]
fn without_motion_there_are_neither_nodes_nor_networks() {
    let (moving, still) = (train(&["motion"]), train(&[]));
    let parts = ["network.", "nodes.", "chain.", "mixing."];
    assert!(parts.iter().all(|prefix| moving.count_tensors(prefix) > 0 && still.count_tensors(prefix) == 0));
    let added = ["neighbor_weights", "neighbor_blend", "slerp", "standardize", "linear", "quaternion_multiply"];
    assert!(added.iter().all(|operation| moving.ran(operation) && !still.ran(operation)), "{:?}", still.operations);
    let everything_else = train(&["attention", "noise", "arap", "physics"]);
    assert_eq!(everything_else.checkpoint, still.checkpoint);
}

#[test]
fn a_single_node_carries_all_gaussians() {
    let tiny = serde_json::json!({ "nodes": { "count": 1, "per_gaussian": 1 } });
    let trained = ShortTraining::run("mcgs", tiny, &["motion"]);
    let is_finite = |bits: &u32| f32::from_bits(*bits).is_finite();
    assert!(trained.checkpoint.iter().all(|(_, bits)| bits.iter().all(is_finite)));
}

#[test]
fn attention_adds_projections_and_a_time_embedding() {
    let (without, with) = (train(&["motion"]), train(&["motion", "attention"]));
    assert!(with.ran("window_attention") && !without.ran("window_attention"));
    let added: Vec<_> = with.tensors.difference(&without.tensors).map(String::as_str).collect();
    assert_eq!(
        added,
        ["chain.key.weight", "chain.output.weight", "chain.query.weight", "chain.time", "chain.value.weight"]
    );
}

#[test]
fn noise_adds_its_level_and_node_visibility() {
    let (without, with) = (train(&["motion"]), train(&["motion", "noise"]));
    let added: Vec<_> = with.tensors.difference(&without.tensors).map(String::as_str).collect();
    assert_eq!(added, ["mixing.noise", "nodes.visibility"]);
    assert_ne!(with.checkpoint, without.checkpoint);
}

#[test]
fn rigidity_and_physics_add_operations_but_no_tensors() {
    let plain = train(&["motion"]);
    for (effect, operation) in [("arap", "quaternion_rotate"), ("physics", "magnitude")] {
        let with = train(&["motion", effect]);
        assert_eq!(with.tensors, plain.tensors);
        assert!(with.ran(operation) && !plain.ran(operation), "{effect}");
    }
}

/// Nodes with these settings, and a state with their tensors and canonical positions.
fn nodes(settings: &Settings, attends: bool) -> (Nodes, ModelState<f64>) {
    let nodes = Nodes::new(settings, attends);
    let mut state = ModelState::new();
    insert_nodes(&mut state, Tensor::from_vec([5, 3], noise(15, 1)), 0.3, &ANY_SCENE);
    let points = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 20, 1);
    nodes.network().insert(&mut state, &points, Streams::new(1));
    nodes.insert_chain(&mut state, Streams::new(1));
    controls::insert(&mut state, settings, false).unwrap();
    (nodes, state)
}

#[test]
fn batched_times_equal_single_times() {
    let (nodes, state) = nodes(&Settings::tiny(), true);
    let scene = scene(11);
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let mut at = |times: &[f64]| {
        let predictions = nodes.predict(&mut tape, &model, times, &scene);
        let motion = nodes.mix(&mut tape, &model, &predictions);
        [motion.translations, motion.rotations].map(|var| tape.value(var).as_slice().to_vec())
    };
    let together = at(&[0.4, 0.5, 0.6]);
    let alone = [0.4, 0.5, 0.6].map(|time| at(&[time]));
    for part in 0..2 {
        let joined = alone.each_ref().map(|motion| motion[part].clone()).concat();
        let worst = together[part].iter().zip(&joined).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst <= 1e-12, "{worst}");
    }
}

#[test]
fn an_untrained_chain_repeats_the_last_state() {
    for attends in [true, false] {
        let (nodes, state) = nodes(&Settings::tiny(), attends);
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let error = nodes.chain_error(&mut tape, &model, &scene(11)).unwrap();
        assert!((error - 1.0).abs() <= 1e-9, "as good as the last state: {error}");
        let [before, now] = [0.4, 0.5].map(|time| nodes.predict(&mut tape, &model, &[time], &scene(11)));
        let worst = |a: Var, b: Var| {
            let pairs = tape.value(a).as_slice().iter().zip(tape.value(b).as_slice());
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(worst(now.chained.translations, before.direct.translations) <= 1e-12, "attends: {attends}");
        assert!(worst(now.chained.rotations, before.direct.rotations) <= 1e-12, "attends: {attends}");
        assert!(
            worst(now.direct.translations, before.direct.translations) > 1e-12,
            "the direct branch does not move between the frames"
        );
    }
}

#[test]
fn the_loss_of_the_predictions_trains_the_chain_alone() {
    let (nodes, mut state) = nodes(&Settings::tiny(), true);
    let scene = scene(11);
    let mut errors = Vec::new();
    for _ in 0..30 {
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| true);
        errors.push(nodes.chain_error(&mut tape, &model, &scene).unwrap());
        let predictions = nodes.predict(&mut tape, &model, &[0.3, 0.4, 0.5, 0.6, 0.7], &scene);
        let loss = prediction::loss(&mut tape, &predictions, &scene);
        let mut gradients = tape.backward(&[(loss, Tensor::full([1], 1.0))]);
        let names: Vec<String> = state.iter().map(|(name, _)| name.to_owned()).collect();
        for name in names {
            let Some(gradient) = gradients.take(model.get(&name)) else { continue };
            assert!(name.starts_with("chain."), "{name} receives a gradient");
            let mut tensor = state.get(&name).unwrap().clone();
            tensor.make_mut().iter_mut().zip(gradient.as_slice()).for_each(|(value, slope)| *value -= 1e-2 * slope);
            state.insert(name, tensor);
        }
    }
    let falls = errors.windows(2).all(|pair| pair[1] < pair[0]);
    assert!(falls && errors[29] < 0.95, "the error does not fall: {errors:?}");
}

#[test]
fn the_error_of_the_chain_needs_motion() {
    let (nodes, mut state) = nodes(&Settings::tiny(), true);
    for name in ["network.translation.weight", "network.translation.bias"] {
        let zeros = Tensor::zeros(state.get(name).unwrap().shape());
        state.insert(name, zeros);
    }
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    assert_eq!(nodes.chain_error(&mut tape, &model, &scene(11)), None, "nothing moves");
}

#[test]
fn a_step_of_the_chain_turns_about_the_axes_of_the_turned_node() {
    let (nodes, mut state) = nodes(&Settings::tiny(), false);
    let mut set_all = |name: &str, values: &[f64]| {
        let mut tensor = state.get(name).unwrap().clone();
        tensor.make_mut().iter_mut().zip(values.iter().cycle()).for_each(|(value, new)| *value = *new);
        state.insert(name, tensor);
    };
    // At every time, the direct branch turns by 90° about x; the step, in frames of a tenth, by 90° about z.
    set_all("network.rotation.weight", &[0.0]);
    set_all("network.rotation.bias", &[0.0, 1.0, 0.0, 0.0]);
    set_all("chain.predictor.2.bias", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0]);
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let chained = nodes.predict(&mut tape, &model, &[0.5], &scene(11)).chained;
    for row in tape.value(chained.rotations).as_slice().as_chunks::<4>().0 {
        // Δq⊗δq of equation 12; δq⊗Δq would have +0.5 at y.
        let expected = [0.5, 0.5, -0.5, 0.5];
        assert!(row.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 1e-12), "{row:?}");
    }
}

#[test]
fn candidates_become_nodes_that_stay_where_they_are() {
    let settings = Settings { nodes_from: NodeSource::Candidates, ..Settings::tiny() };
    let method = Mcgs::build::<f64>(&Mcgs::shared_defaults(), settings.clone());
    let phases: Vec<_> = method.phases().into_iter().map(|phase| (phase.name, phase.iterations)).collect();
    let expected =
        [("place-candidates", 2000), ("choose-nodes", 5500), ("settle-nodes", 2500), (WARM_UP, 3000), (ALL, 27_000)];
    assert_eq!(phases, expected);
    let learns = |method: &dyn Method<f64>, phase, tensor| method.learning_rate(phase, tensor, &scene(11)).is_some();
    assert!(learns(&*method, "settle-nodes", "candidates.positions"));
    assert!(!learns(&*method, ALL, "nodes.positions") && learns(&*method, ALL, "nodes.log_radii"));
    assert!(!learns(&*method, WARM_UP, "network.hidden.0.weight") && learns(&*method, ALL, "network.hidden.0.weight"));
    let trained = ShortTraining::run(Mcgs::NAME, to_value(settings).unwrap(), &["motion"]);
    assert!(trained.count_tensors("nodes.") > 0 && trained.count_tensors("candidates.") == 0);
    let of_gaussians = Mcgs::build::<f64>(&Mcgs::shared_defaults(), Settings::tiny());
    assert!(of_gaussians.phases()[..3].iter().all(|phase| phase.iterations == 0));
    assert!(learns(&*of_gaussians, ALL, "nodes.positions"));
}

#[test]
fn views_of_the_direct_branch_skip_the_chain() {
    let share = |direct_views: f64| {
        let mut settings = Settings::tiny();
        settings.mixing.direct_views = direct_views;
        let training = ShortTraining::run(Mcgs::NAME, to_value(settings).unwrap(), &["motion"]);
        (training.ran("standardize"), training.checkpoint)
    };
    let [(mixed, one), (direct, other)] = [0.0, 1.0].map(share);
    assert!(mixed && !direct && one != other);
}

#[test]
fn states_before_the_start_repeat_the_first() {
    let (nodes, state) = nodes(&Settings::tiny(), true);
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let first = nodes.predict(&mut tape, &model, &[0.0], &scene(11));
    let values = |var| tape.value(var).as_slice();
    assert_eq!(values(first.chained.translations), values(first.direct.translations));
    assert!(values(first.chained.rotations).iter().all(|value| value.is_finite()));
}

#[test]
fn zero_node_motion_leaves_gaussians_unchanged() {
    let (nodes, mut state) = nodes(&Settings::tiny(), true);
    let points = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 20, 1);
    gaussians::insert_gaussians(&mut state, GAUSSIANS, &points, 0, &scene(5));
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let canonical = gaussians::static_splats(&mut tape, &model, GAUSSIANS, 0);
    let translations = tape.constant(Tensor::zeros([5, 3]));
    let rest = NodeMotion { translations, rotations: identity_rotations(&mut tape, 5) };
    let carried = nodes.carry(&mut tape, &model, &moment(0.5, ALL), canonical, &rest);
    assert_eq!(tape.value(carried.positions), tape.value(canonical.positions));
    let rotations = |splats: &SplatVars| tape.value(splats.shape.scales_and_rotations().unwrap().1).clone();
    shaders::check::agree(&rotations(&carried), &rotations(&canonical), 1e-14).unwrap();
}

#[test]
fn the_visibility_of_all_views_of_a_step_counts() {
    let ramp = controls::Ramp::new(&Settings::default(), 3000, 1.0);
    let mut visibility = controls::Visibility::new(1, &ramp);
    for weights in [[0.25, 1.0], [0.75, 2.0]] {
        visibility.observe_value(VISIBILITY, &Tensor::from_vec([1, 2], weights.to_vec()));
    }
    assert_eq!(visibility.seen.unwrap().as_slice(), [1.0, 3.0]);
}

#[test]
fn the_noise_in_the_mixture_reaches_most_of_a_pixel_at_every_size() {
    let (settings, ramp) = (Settings::default(), controls::Ramp::new(&Settings::default(), 3000, 1.0));
    for width in [64, 800] {
        let camera = PinholeCamera {
            width,
            height: width,
            focal: [1.1 * width as f64; 2],
            center: [0.5 * width as f64; 2],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        // The mixture contains the share λ of the noise, of which a part is left.
        let share = |iteration| ramp.shares_at(iteration)[0] * ramp.noise_at(iteration);
        let largest = (0..27_000).step_by(100).map(share).fold(0.0, f64::max);
        // A node at the distance of one extent that is always visible.
        let pixels = largest * settings.noise.position_world(4.0, &camera) / 4.0 * camera.focal[0];
        assert!((0.8..1.2).contains(&pixels), "{pixels} px at {width}");
    }
}
