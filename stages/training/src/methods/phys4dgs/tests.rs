mod devices;
mod geometry;

use std::collections::{BTreeMap, BTreeSet};

use scene::LabelMap;
use serde_json::{Value, json};
use shaders::arrays::sample::{SampleSize, sample_rows};
use shaders::check::noise;
use shaders::tape::{Device, Tape, Tensor, Var};

use super::*;
use crate::check::Table as _;
use crate::clock::{ClockReading, PhaseClock};
use crate::data::{Dataset, NOTHING, Streams, Supplements, TrainingView, ViewConstants};
use crate::method::{LossUnits, Recorded, SkippedWork, Start, raster_settings, run_step};
use crate::model::ModelState;
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;
use crate::shared::InitialPoints;
use crate::trainer::Trainer;

const PHYSICS: [&str; 6] = ["velocity", "displacement", "higher-order", "flow", "true-displacement", "foreground"];

fn named(effects: &[&str]) -> Effects {
    Effects::Named(effects.iter().map(ToString::to_string).collect())
}

/// The test scene with every supplement.
struct World {
    dataset: Dataset,
    supplements: Supplements,
    _dir: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let scene = TestScene { size: 16, ..TestScene::default() };
        let dataset = Dataset::load(scene.write(dir.path()), 1).unwrap();
        let supplements = scene.supplements(&dataset);
        Self { dataset, supplements, _dir: dir }
    }

    fn params(&self, method: &str, effects: &[&str], settings: Value) -> TrainingParams {
        let mut params = TrainingParams::of(method).unwrap();
        params.shared.effects = named(effects);
        params.shared.initial_points.max_count = 8;
        params.settings = settings;
        params
    }

    fn phys4dgs(&self, effects: &[&str], settings: &Phys4dgsSettings) -> TrainingParams {
        self.params("phys4dgs", effects, serde_json::to_value(settings).unwrap())
    }

    fn deformable4dgs(&self, effects: &[&str], settings: &HexplaneSettings) -> TrainingParams {
        self.params("deformable4dgs", effects, serde_json::to_value(settings).unwrap())
    }

    /// Runs the first step of `fine` on a training view, on the CPU.
    fn step(&self, params: &TrainingParams, view: usize) -> Observation {
        let method = params.registration().build_f64(&params.shared, &params.settings).unwrap();
        self.step_on(Device::Cpu, &*method, params, view)
    }

    /// Runs the first step of `fine` on a training view, on this device.
    fn step_on<T: Real>(
        &self,
        device: Device,
        method: &dyn Method<T>,
        params: &TrainingParams,
        view: usize,
    ) -> Observation {
        let (state, mut tape) = (self.fine_state(method), Tape::new(device));
        let outcome = self.in_step(&mut tape, &state, method, (params, view), |step| run_step(method, step).unwrap());
        let (losses, skipped) = outcome.read_back();
        Observation {
            tensors: state.names().map(String::from).collect(),
            losses,
            skipped,
            operations: tape.profile().ops.iter().map(|(name, cost)| (*name, cost.forward.calls)).collect(),
        }
    }

    /// A model at the start of `fine`, with motion.
    fn fine_state<T: Real>(&self, method: &dyn Method<T>) -> ModelState<T> {
        let start = Start { dataset: &self.dataset, supplements: &self.supplements };
        let points = self.dataset.initial_points(&InitialPoints { max_count: 8, ..Default::default() }, 0).unwrap();
        let random = Streams::new(1);
        let mut state = method.initialize(&start, &points, random).unwrap();
        for phase in method.phases() {
            state = method.enter_phase(phase.name, state, &start, random).unwrap();
        }
        vary_in_time(&mut state);
        state
    }

    /// Calls a function with the first step of `fine` on a training view.
    fn in_step<T: Real, R>(
        &self,
        tape: &mut Tape<T>,
        state: &ModelState<T>,
        method: &dyn Method<T>,
        (params, view): (&TrainingParams, usize),
        act: impl FnOnce(Step<'_, T>) -> R,
    ) -> R {
        let model = state.bind(tape, |name| method.learning_rate("fine", name, &self.dataset.scene).is_some());
        let view: TrainingView<T> = self.dataset.train[view].to_training();
        act(Step {
            tape,
            model: &model,
            views: std::slice::from_ref(&view),
            scene: &self.dataset.scene,
            dataset: &self.dataset,
            supplements: &self.supplements,
            shared: &params.shared,
            phase: "fine",
            iteration: 1,
            sh_degree: 0,
            harmonics_intervals: 0,
            raster: raster_settings(&self.dataset.scene, 0),
            random: Streams::new(1).step("fine", 1),
            clock: &mut PhaseClock::start("test", ClockReading::default()),
            constants: &ViewConstants::default(),
            units: &LossUnits::default(),
            recorded: Recorded::default(),
        })
    }
}

/// Adds variation in time to the time planes, which are constant in a fresh field.
fn vary_in_time<T: Real>(state: &mut ModelState<T>) {
    let planes: Vec<String> = state.names().filter(|name| name.starts_with("field.plane_")).map(String::from).collect();
    for name in planes.into_iter().filter(|name| name.ends_with('t')) {
        let plane = state.get(&name).unwrap();
        let moved =
            plane.as_slice().iter().zip(noise(plane.len(), 5)).map(|(&value, shift)| value + T::from_f64(0.1 * shift));
        state.insert(name, Tensor::from_vec(plane.shape(), moved.collect()));
    }
}

/// Losses, skipped work, tensors and operations of one step.
struct Observation {
    tensors: BTreeSet<String>,
    losses: BTreeMap<&'static str, f64>,
    skipped: SkippedWork,
    operations: BTreeMap<&'static str, u64>,
}

impl Observation {
    /// Names of the losses that the base does not have.
    fn physics(&self) -> Vec<&str> {
        let of_base = ["photometric", "spatial_smoothness", "temporal_smoothness", "time_to_one"];
        self.losses.keys().copied().filter(|name| !of_base.contains(name)).collect()
    }
}

#[test]
fn disabled_effects_add_no_tensors_losses_or_operations() {
    let (world, tiny) = (World::new(), Phys4dgsSettings::tiny());
    let plain = world.step(&world.deformable4dgs(&["motion"], &tiny.field), 3);
    // Effects in addition to motion, tensors in addition to the base's, field evaluations in addition to the render's,
    // losses.
    type Row<'a> = (&'a [&'a str], usize, u64, &'a [&'a str]);
    let rows: [Row<'_>; 8] = [
        (&[], 0, 0, &[]),
        (&["flow"], 0, 0, &[]),
        (&["displacement"], 4, 2, &["displacement"]),
        (&["velocity"], 8, 3, &["temporal", "velocity"]),
        (&["higher-order"], 4, 4, &["acceleration", "jerk"]),
        (&["true-displacement"], 0, 2, &["true_displacement"]),
        (&["velocity", "flow"], 8, 3, &["flow", "temporal", "velocity"]),
        (
            &PHYSICS,
            8,
            4,
            &["acceleration", "displacement", "flow", "jerk", "temporal", "true_displacement", "velocity"],
        ),
    ];
    for (effects, tensors, evaluations, losses) in rows {
        let found = world.step(&world.phys4dgs(&[&["motion"], effects].concat(), &tiny), 3);
        assert_eq!(found.tensors.len(), plain.tensors.len() + tensors, "{effects:?}");
        assert_eq!(found.operations["hexplane"], plain.operations["hexplane"] + evaluations, "{effects:?}");
        assert_eq!(found.physics(), losses, "{effects:?}");
        assert!(losses.iter().all(|name| found.losses[name] > 0.0), "{effects:?}: {:?}", found.losses);
        if losses.is_empty() {
            assert_eq!(found.operations, plain.operations, "{effects:?}");
            assert_eq!(found.losses, plain.losses, "{effects:?}");
        }
    }
}

#[test]
fn without_motion_no_physics_effect_is_active() {
    let world = World::new();
    let found = world.step(&world.phys4dgs(&PHYSICS, &Phys4dgsSettings::tiny()), 3);
    assert!(found.tensors.iter().all(|name| name.starts_with("gaussians.") || name == "field.bounds"));
    assert!(found.physics().is_empty() && !found.operations.contains_key("hexplane"));
}

#[test]
fn without_physics_training_equals_deformable4dgs() {
    let world = World::new();
    let train = |mut params: TrainingParams| {
        params.shared.iterations = BTreeMap::from([("coarse".into(), 6), ("fine".into(), 10)]);
        let mut trainer = Trainer::new(&world.dataset, &NOTHING, &params).unwrap();
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        trainer.finish().unwrap().tensors
    };
    let tiny = Phys4dgsSettings::tiny();
    let of_base = train(world.deformable4dgs(&["motion"], &tiny.field));
    let mut params = world.phys4dgs(&["motion"], &tiny);
    assert!(train(params.clone()) == of_base);
    // Planted fault: different initial values change the result.
    params.shared.seed = 1;
    assert!(train(params) != of_base);
}

#[test]
fn losses_need_their_frames_within_the_clip() {
    let (mut world, tiny) = (World::new(), Phys4dgsSettings::tiny());
    world.supplements = NOTHING.clone();
    let params = world.phys4dgs(&["motion", "velocity", "higher-order"], &tiny);
    // Eight views: a frame lasts an eighth of the clip, and the views are a seventh apart.
    assert_eq!(world.step(&params, 7).physics(), Vec::<&str>::new());
    assert_eq!(world.step(&params, 6).physics(), ["velocity"]);
    assert_eq!(world.step(&params, 5).physics(), ["acceleration", "temporal", "velocity"]);
    assert_eq!(world.step(&params, 4).physics(), ["acceleration", "jerk", "temporal", "velocity"]);
}

#[test]
fn static_gaussians_are_skipped_and_counted() {
    let (world, mut tiny) = (World::new(), Phys4dgsSettings::tiny());
    tiny.field.zero_heads = true; // A field without effect.
    let unobserved = ["motion", "velocity", "displacement", "higher-order", "foreground"];
    let found = world.step(&world.phys4dgs(&unobserved, &tiny), 3);
    let [skipped, of] = found.skipped["physical losses of static Gaussians"];
    assert!(skipped == of && of > 0 && found.physics().is_empty(), "{skipped} of {of}, {:?}", found.losses);
    let moving = world.step(&world.phys4dgs(&["motion", "velocity"], &Phys4dgsSettings::tiny()), 3);
    let [skipped, of] = moving.skipped["physical losses of static Gaussians"];
    assert!(skipped < of, "{skipped} of {of}");
}

#[test]
fn observations_can_start_motion() {
    let (world, mut tiny) = (World::new(), Phys4dgsSettings::tiny());
    tiny.field.zero_heads = true;
    for (effects, loss) in [(["displacement", "flow"], "flow"), (["true-displacement"; 2], "true_displacement")] {
        let found = world.step(&world.phys4dgs(&[&["motion"][..], &effects].concat(), &tiny), 3);
        assert!(found.losses[loss] > 0.0, "{effects:?}: {:?}", found.losses);
        assert!(!found.skipped.contains_key("physical losses of static Gaussians"));
    }
}

#[test]
fn heads_follow_the_field_and_do_not_shape_it() {
    let world = World::new();
    let params = world.phys4dgs(&["motion", "velocity"], &Phys4dgsSettings::tiny());
    let method = PhysicalGaussians::new(&params.shared, Phys4dgsSettings::tiny());
    let mut state = world.fine_state::<f64>(&method);
    let last = "network.velocity.1.weight";
    let shape = state.get(last).unwrap().shape().to_vec();
    let count = shape.iter().product();
    state.insert(last, Tensor::from_vec(shape, noise(count, 8)));
    let mut tape = Tape::new(Device::Cpu);
    let reached = world.in_step(&mut tape, &state, &method, (&params, 3), |mut step| {
        let sampled = sample_rows(Device::Cpu, &Tensor::full([8], 1.0), SampleSize { share: 1.0, most: 8 }, 1);
        let time = step.views[0].time;
        let followed = trajectories::Trajectories::follow(&mut step, &method.base, &sampled, time, 2, false).unwrap();
        let velocity = method.kinematics(&mut step, &followed).velocity.unwrap();
        let seed = Tensor::full(step.tape.value(velocity).shape(), 1.0);
        let gradients = step.tape.backward(&[(velocity, seed)]);
        let is_reached = |(name, var): (&str, Var)| gradients.get(var).is_some().then(|| name.to_owned());
        step.model.iter().filter_map(is_reached).collect::<Vec<_>>()
    });
    assert!(!reached.is_empty() && reached.iter().all(|name| name.starts_with("network.velocity.")), "{reached:?}");
}

#[test]
fn flow_from_frame_to_frame_is_compared_with_acceleration_and_jerk() {
    let (mut world, mut tiny) = (World::new(), Phys4dgsSettings::tiny());
    let effects = ["motion", "higher-order", "flow"];
    let flow = |world: &World, settings: &Phys4dgsSettings| {
        let found = world.step(&world.phys4dgs(&effects, settings), 3);
        let of_flow = |name: &&&str| name.starts_with("flow") && found.losses[**name] > 0.0;
        found.losses.keys().filter(of_flow).copied().collect::<Vec<_>>()
    };
    assert!(flow(&world, &tiny).is_empty(), "flow over two frames has no part in differences from frame to frame");
    // The views are a seventh of the clip apart and a frame lasts an eighth: make both equal.
    world.dataset.scene.time_map.frame_secs = 2.0 / 7.0;
    for (view, priors) in world.dataset.capture.views.iter().zip(&mut world.supplements.priors) {
        priors.flow.as_mut().unwrap().time_to_secs = view.time_secs + 2.0 / 7.0;
    }
    assert_eq!(flow(&world, &tiny), ["flow_acceleration", "flow_jerk"]);
    tiny.weights.jerk = 0.0;
    assert_eq!(flow(&world, &tiny), ["flow_acceleration"]);
    let next = world.dataset.train[4].index;
    world.supplements.priors[next].flow = None;
    assert!(flow(&world, &tiny).is_empty(), "without flow at the next instant there is no change to see");
}

#[test]
fn a_static_view_has_no_physical_losses() {
    let mut world = World::new();
    let params = world.phys4dgs(&[&["motion"][..], &PHYSICS].concat(), &Phys4dgsSettings::tiny());
    let index = world.dataset.train[3].index;
    let background = |world: &World| world.step(&params, 3).skipped["physical losses of Gaussians in the background"];
    let [some, all] = background(&world);
    assert!(0 < some && some < all, "{some} of {all}");
    world.supplements.moving[index] = Some(LabelMap { width: 16, height: 16, labels: vec![0; 256] });
    assert_eq!(background(&world), [all, all]);
    assert!(world.step(&params, 3).physics().is_empty());
    let everywhere = world.phys4dgs(&["motion", "velocity"], &Phys4dgsSettings::tiny());
    assert!(!world.step(&everywhere, 3).physics().is_empty(), "without `foreground` no mask is read");
}

#[test]
fn gaussians_that_may_not_move_are_not_compared() {
    let world = World::new();
    let params = world.phys4dgs(&["motion", "velocity"], &Phys4dgsSettings::tiny());
    let method = PhysicalGaussians::new(&params.shared, Phys4dgsSettings::tiny());
    let step = |may_move: [f64; 8]| {
        let (mut state, mut tape) = (world.fine_state::<f64>(&method), Tape::new(Device::Cpu));
        state.insert(static_mask::MAY_MOVE, Tensor::from_vec([8, 1], may_move.to_vec()));
        let run = |step: Step<'_, f64>| run_step(&method, step).unwrap().read_back();
        let (losses, skipped) = world.in_step(&mut tape, &state, &method, (&params, 3), run);
        (losses.contains_key("velocity"), skipped["physical losses of Gaussians in the background"])
    };
    assert_eq!(step([1.0; 8]), (true, [0, 8]));
    assert_eq!(step([1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0]), (true, [4, 8]));
    assert_eq!(step([0.0; 8]), (false, [8, 8]));
}

#[test]
fn flow_loss_needs_motion_and_a_later_frame() {
    let mut world = World::new();
    let params = world.phys4dgs(&["motion", "velocity", "flow"], &Phys4dgsSettings::tiny());
    let index = world.dataset.train[3].index;
    assert!(world.step(&params, 3).losses.contains_key("flow"));
    let flow = world.supplements.priors[index].flow.as_mut().unwrap();
    flow.time_to_secs = world.dataset.capture.views[index].time_secs;
    assert!(!world.step(&params, 3).losses.contains_key("flow"));
}

#[test]
fn weights_grow_from_zero_over_the_stretched_ramp() {
    let mut shared = HexplaneSettings::shared_defaults();
    shared.schedule_scale = 0.1;
    let method = PhysicalGaussians::new(&shared, Phys4dgsSettings { ramp: [1000, 3000], ..Phys4dgsSettings::tiny() });
    assert_eq!([50, 100, 200, 300, 900].map(|iteration| method.gain("fine", iteration)), [0.0, 0.0, 0.5, 1.0, 1.0]);
    assert_eq!(method.gain("coarse", 900), 0.0);
    shared.effects = named(&["motion", "higher-order"]);
    let seldom = Phys4dgsSettings { higher_order_interval: 3, ..Phys4dgsSettings::tiny() };
    let seldom = PhysicalGaussians::new(&shared, seldom);
    assert_eq!([301, 302, 303].map(|iteration| seldom.gain("fine", iteration)), [0.0, 0.0, 1.0]);
    shared.effects = named(&["motion", "velocity", "flow"]);
    let every_second = Phys4dgsSettings { flow_interval: 2, higher_order_interval: 2, ..Phys4dgsSettings::tiny() };
    let every_second = PhysicalGaussians::new(&shared, every_second);
    assert_eq!([300, 301].map(|iteration| every_second.due(iteration).flow), [true, false]);
    shared.effects = named(&["motion", "flow"]);
    assert_eq!(PhysicalGaussians::new(&shared, Phys4dgsSettings::tiny()).gain("fine", 900), 0.0);
}

#[test]
fn a_partial_field_table_keeps_the_papers_rates() {
    let read = |value: Value| serde_json::from_value::<Phys4dgsSettings>(value);
    let settings = read(json!({ "field": { "channels": 8 }, "weights": { "jerk": 0.0 } })).unwrap();
    assert_eq!(settings.field.plane_rate, Phys4dgsSettings::default().field.plane_rate);
    assert_eq!((settings.field.channels, settings.weights.velocity), (8, 0.06));
    assert!(read(json!({ "field": { "chanels": 8 } })).is_err());
    let bad = [
        ("sample_share", json!({ "sample_share": 0.0 })),
        ("ramp", json!({ "ramp": [5, 4] })),
        ("higher_order_interval", json!({ "higher_order_interval": 0 })),
        ("higher_order_interval", json!({ "flow_interval": 3 })),
        ("weights.flow", json!({ "weights": { "flow": -1.0 } })),
        ("field.heads.position", json!({ "field": { "heads": { "position": false } } })),
    ];
    bad.into_iter().for_each(|(key, table)| assert_eq!(read(table).unwrap().check().keys(), [key]));
}

#[test]
fn without_supplements_only_self_consistency_losses_remain() {
    let mut world = World::new();
    world.supplements = NOTHING.clone();
    let found = world.step(&world.phys4dgs(&[&["motion"][..], &PHYSICS].concat(), &Phys4dgsSettings::tiny()), 3);
    assert_eq!(found.physics(), ["acceleration", "displacement", "jerk", "temporal", "velocity"]);
}
