mod devices;
mod flow;
mod schedules;
mod training;

use std::collections::BTreeSet;

use shaders::check;
use shaders::pointwise::add;
use shaders::tape::{Device, Var};

use super::*;
use crate::bases::anchors::{COARSE, DeformationSettings};
use crate::clock::{ClockReading, PhaseClock};
use crate::data::{Dataset, NOTHING, Streams, Supplements, ViewConstants};
use crate::effects::Effects;
use crate::method::{LossUnits, Recorded, StepOutcome, raster_settings, run_step};
use crate::scene_tests::TestScene;

/// The method's state at the start of a phase on the test scene.
struct World {
    method: KineticGaussians<f64>,
    state: ModelState<f64>,
    dataset: Dataset,
    supplements: Supplements,
}

impl World {
    fn new(effects: &[&str], settings: Settings, phase: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let test_scene = TestScene::default();
        let dataset = Dataset::load(test_scene.write(dir.path()), 1).unwrap();
        let supplements = test_scene.supplements(&dataset);
        let effects = Effects::Named(effects.iter().map(|name| name.to_string()).collect());
        let method = KineticGaussians::new(&Shared { effects, ..Kineticgs::shared_defaults() }, settings);
        let start = Start { dataset: &dataset, supplements: &supplements };
        let points = dataset.capture.load_points().unwrap().unwrap();
        let random = Streams::new(5);
        let mut state = method.initialize(&start, &points, random).unwrap();
        for name in [COARSE, FINE] {
            state = method.enter_phase(name, state, &start, random).unwrap();
            if name == phase {
                break;
            }
        }
        Self { method, state, dataset, supplements }
    }

    fn fine(effects: &[&str]) -> Self {
        Self::new(effects, Settings::tiny(), FINE)
    }

    /// Runs one step on a view: its losses, and the number of operations of the forward pass.
    fn step(&self, phase: &str, view: usize) -> (StepOutcome<f64>, usize) {
        let mut tape = Tape::new(Device::Cpu);
        let learns =
            |name: &str| Method::<f64>::learning_rate(&self.method, phase, name, &self.dataset.scene).is_some();
        let model = self.state.bind(&mut tape, learns);
        let step = Step {
            tape: &mut tape,
            model: &model,
            views: &[self.dataset.train[view].to_training()],
            scene: &self.dataset.scene,
            dataset: &self.dataset,
            supplements: &self.supplements,
            shared: &self.method.shared,
            phase,
            iteration: 1,
            sh_degree: 0,
            harmonics_intervals: 0,
            raster: raster_settings(&self.dataset.scene, 0),
            random: Streams::new(2).step("fine", 1),
            clock: &mut PhaseClock::start("test", ClockReading::default()),
            constants: &ViewConstants::default(),
            units: &LossUnits::default(),
            recorded: Recorded::default(),
        };
        let outcome = run_step(&self.method, step).unwrap();
        let skipped = outcome.read_back().1;
        let outcome = StepOutcome { skipped, deferred: Vec::new(), ..outcome };
        let operations = tape.profile().ops.values().map(|cost| cost.forward.calls as usize).sum();
        (outcome, operations)
    }
}

const ALL: [&str; 5] = [MOTION, MOMENTUM_INIT, ACTIVATION, ENERGY_FLOW, COHERENCE];

#[test]
fn every_effect_owns_its_tensors_operations_and_losses() {
    let names = |world: &World| world.state.names().map(str::to_string).collect::<BTreeSet<_>>();
    let whole = World::fine(&ALL);
    let (outcome, operations) = whole.step(FINE, 0);
    for loss in ["photometric", "activation", "energy_flow", "coherence"] {
        assert!(outcome.losses().contains_key(loss), "no loss {loss}");
    }
    let brings = [
        (MOMENTUM_INIT, "anchors.dynamic", ""),
        (ACTIVATION, "activation.0.weight", "activation"),
        (ENERGY_FLOW, "", "energy_flow"),
        (COHERENCE, "", "coherence"),
    ];
    for (effect, tensor, loss) in brings {
        let others: Vec<&str> = ALL.into_iter().filter(|name| *name != effect).collect();
        let without = World::fine(&others);
        let (outcome, fewer) = without.step(FINE, 0);
        if effect != MOMENTUM_INIT {
            assert!(fewer < operations, "{effect}: {fewer} operations without it, {operations} with it");
        }
        assert!(tensor.is_empty() || names(&whole).contains(tensor) && !names(&without).contains(tensor), "{effect}");
        assert!(!outcome.losses().contains_key(loss), "{effect} is off, but its loss is present");
    }
}

#[test]
fn without_motion_no_motion_tensor_exists() {
    let world = World::fine(&[MOMENTUM_INIT, ACTIVATION, ENERGY_FLOW, COHERENCE]);
    assert!(world.state.names().all(|name| name != DYNAMIC && (belongs(name, "anchors") || belongs(name, "views"))));
    let (outcome, operations) = world.step(FINE, 0);
    assert_eq!(outcome.losses().keys().copied().collect::<Vec<_>>(), ["photometric"]);
    assert_eq!(operations, world.step(COARSE, 0).1);
    assert!(outcome.skipped.is_empty());
}

#[test]
fn zero_initialised_heads_cause_no_motion() {
    // With particles in `coarse` too, both phases draw the same Gaussians.
    let world = World::new(&ALL, Settings { coarse_all: true, ..Settings::tiny() }, FINE);
    let positions = |phase: &str, time: f64| {
        let mut tape = Tape::new(Device::Cpu);
        let model = world.state.bind(&mut tape, |_| false);
        let camera = &world.dataset.train[0].camera;
        let moment = Moment { scene: &world.dataset.scene, phase, time, camera, sh_degree: 0, left_out: None };
        let splats = world.method.splats(&mut tape, &model, &moment).unwrap();
        tape.value(splats.positions).clone()
    };
    for time in [0.0, 0.5, 1.0] {
        check::agree(&positions(FINE, time), &positions(COARSE, 0.0), 1e-12).unwrap();
    }
}

/// A model with particles that have different windows, some of them closed at [`SPLIT_TIME`].
fn with_split_windows(effects: &[&str]) -> World {
    let settings = Settings { deformation: DeformationSettings::tiny(), ..Settings::tiny() };
    let mut world = World::new(effects, settings, FINE);
    // A large weight spreads the window centres, a low bias shortens the windows.
    let spread = world.state.get("activation.center.weight").unwrap().as_slice().iter().map(|w| 30.0 * w).collect();
    world.state.insert("activation.center.weight", Tensor::from_vec([1, 64], spread));
    world.state.insert("activation.radius.bias", Tensor::full([1], -1.0));
    world
}

const SPLIT_TIME: f64 = 0.5;

#[test]
fn closed_gates_keep_positions_and_pass_a_gradient_to_their_windows() {
    let world = with_split_windows(&[MOTION, ACTIVATION]);
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |name| name.starts_with("activation."));
    let particles = world.method.particles(&mut tape, &model, &world.dataset.scene);
    let moved = world.method.motion.at(&mut tape, &model, &particles, SPLIT_TIME);
    let window = particles.windows.unwrap().at(&mut tape, SPLIT_TIME);
    let [canonical, found, displacements] =
        [particles.positions, moved.anchors.positions, moved.displacements.unwrap()]
            .map(|var| tape.value(var).as_slice().as_chunks::<3>().0.to_vec());
    let is_open: Vec<bool> = tape.value(window).as_slice().iter().map(|&w| w > 0.01).collect();
    assert!(is_open.contains(&true) && is_open.contains(&false), "the test needs both kinds");
    for (at, &open) in is_open.iter().enumerate() {
        let expected = if open { displacements[at] } else { [0.0; 3] };
        let shift = [0, 1, 2].map(|axis| found[at][axis] - canonical[at][axis]);
        assert!([0, 1, 2].iter().all(|&axis| (shift[axis] - expected[axis]).abs() <= 1e-12), "{at}: {shift:?}");
    }
    // Only the closed particle with the widest gate pulls.
    let closed = (0..is_open.len()).filter(|&at| !is_open[at]);
    let widest = closed.max_by(|&a, &b| tape.value(window).as_slice()[a].total_cmp(&tape.value(window).as_slice()[b]));
    let mut pull = vec![0.0; 3 * is_open.len()];
    pull[3 * widest.unwrap()..][..3].copy_from_slice(&displacements[widest.unwrap()]);
    let pull = Tensor::from_vec([is_open.len(), 3], pull);
    let radius = model.get("activation.radius.bias");
    let gradient = tape.backward(&[(moved.anchors.positions, pull)]).take(radius).unwrap();
    assert!(gradient.as_slice()[0] > 0.0, "a wider window moves the particle: {gradient:?}");
}

#[test]
fn without_a_threshold_all_particles_move_and_positions_do_not_train_the_windows() {
    let deformation = DeformationSettings::tiny();
    let settings = Settings { deformation, gate_threshold: Settings::default().gate_threshold, ..Settings::tiny() };
    let world = World::new(&[MOTION, ACTIVATION], settings, FINE);
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |_| true);
    let particles = world.method.particles(&mut tape, &model, &world.dataset.scene);
    let moved = world.method.motion.at(&mut tape, &model, &particles, SPLIT_TIME);
    let at_time = world.method.motion.positions_at(&mut tape, &model, &particles, SPLIT_TIME);
    let expected = add(&mut tape, particles.positions, moved.displacements.unwrap());
    for found in [moved.anchors.positions, at_time] {
        check::agree(tape.value(found), tape.value(expected), 1e-12).unwrap();
        let ones = Tensor::full(tape.value(found).shape(), 1.0);
        let mut gradients = tape.backward(&[(found, ones)]);
        assert!(gradients.take(model.get("activation.radius.bias")).is_none());
        assert!(gradients.take(model.get("anchor_network.position.1.bias")).is_some());
    }
}

#[test]
fn static_anchors_are_counted() {
    let (outcome, _) = World::fine(&ALL).step(FINE, 0);
    let [static_anchors, anchors] = outcome.skipped["motion of static anchors"];
    assert_eq!(anchors - static_anchors, 3);
}

#[test]
fn coarse_neither_draws_nor_trains_particles() {
    let observed = |coarse_all: bool| {
        let world = World::new(&ALL, Settings { coarse_all, ..Settings::tiny() }, COARSE);
        let (outcome, _) = world.step(COARSE, 0);
        let flags = world.state.get(DYNAMIC).unwrap().as_slice().to_vec();
        let rows = outcome.renders[0].rows.as_ref().unwrap();
        let per_anchor = rows.count / flags.len();
        let of_particles = |&&slot: &&u32| flags[slot as usize / per_anchor] == 1.0;
        let drawn = rows.row_of_splat.as_ref().unwrap().iter().filter(of_particles).count();
        (drawn, trained_in_coarse(&world))
    };
    assert_eq!(observed(false), (0, false));
    let (drawn, trained) = observed(true);
    assert!(drawn > 0 && trained, "the test scene shows its particles");
}

/// Whether a step of `coarse` gives the features of any particle a gradient.
fn trained_in_coarse(world: &World) -> bool {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |name| name == "anchors.features");
    let camera = &world.dataset.train[0].camera;
    let splats = world.method.static_gaussians(&mut tape, &model, camera).splats;
    let weights = Tensor::from_vec(tape.value(splats.sh).shape(), check::noise(tape.value(splats.sh).len(), 3));
    let ones = Tensor::full(tape.value(splats.opacity_logits).shape(), 1.0);
    let mut gradients = tape.backward(&[(splats.sh, weights), (splats.opacity_logits, ones)]);
    let gradient = gradients.take(model.get("anchors.features")).unwrap();
    let flags = world.state.get(DYNAMIC).unwrap().as_slice();
    let is_trained = |row: usize| flags[row] == 1.0 && gradient.row(row).iter().any(|&value| value != 0.0);
    (0..flags.len()).any(is_trained)
}

#[test]
fn the_report_says_how_many_particles_are_active_when() {
    let world = with_split_windows(&[MOTION, ACTIVATION]);
    let mut tape = Tape::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |_| false);
    let figures = world.method.figures(&mut tape, &model, &world.dataset.scene);
    let at_half = figures["particles active at 50 % of the clip (%)"];
    assert!(0.0 < at_half && at_half < 100.0, "{figures:?}");
    let width = figures["width of the windows, mean (% of the clip)"];
    assert!((2.0..100.0).contains(&width), "{figures:?}");
    let still = World::fine(&[]);
    let mut tape = Tape::new(Device::Cpu);
    let model = still.state.bind(&mut tape, |_| false);
    assert!(still.method.figures(&mut tape, &model, &still.dataset.scene).is_empty());
}

#[test]
fn windows_open_and_close_as_in_the_paper() {
    let mut world = World::fine(&ALL);
    // Δ^ct = 0 and Δ^cr = tanh 1.5.
    world.state.insert("activation.center.weight", Tensor::zeros([1, 64]));
    world.state.insert("activation.radius.weight", Tensor::zeros([1, 64]));
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |_| false);
    let windows = world.method.particles(&mut tape, &model, &world.dataset.scene).windows.unwrap();
    let radius = 0.25 + 0.24 * 1.5_f64.tanh();
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    for time in [0.0, 0.02, 0.5, 0.9, 1.0] {
        let expected = sigmoid((time - 0.5 + radius) / 0.02) * sigmoid((0.5 + radius - time) / 0.02);
        let found = windows.at(&mut tape, time);
        check::agree(tape.value(found), &Tensor::full([3, 1], expected), 1e-12).unwrap();
    }
    let start = windows.at(&mut tape, 0.0);
    assert!(tape.value(start).as_slice().iter().all(|&gate| gate > 0.01), "no particle is frozen initially");
}

#[test]
fn momentum_init_requires_particles() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(TestScene::default().write(dir.path()), 1).unwrap();
    let points = dataset.capture.load_points().unwrap().unwrap();
    let method = KineticGaussians::new(&Kineticgs::shared_defaults(), Settings::tiny());
    let random = Streams::new(1);
    let start = Start { dataset: &dataset, supplements: &NOTHING };
    assert!(Method::<f64>::initialize(&method, &start, &points, random).is_err());
    // Two particles in one voxel are merged at the position of the first.
    let seeds = PointCloud { positions: vec![[9.0, 0.0, 0.01], [9.0, 0.0, 0.0]], colors: vec![[0; 3]; 2] };
    let supplements = Supplements { particles: Some(seeds), ..Supplements::default() };
    let start = Start { dataset: &dataset, supplements: &supplements };
    let state = Method::<f64>::initialize(&method, &start, &points, random).unwrap();
    let positions = state.get("anchors.positions").unwrap();
    let flags = state.get(DYNAMIC).unwrap().as_slice();
    assert_eq!(flags.iter().sum::<f64>(), 1.0);
    assert!((positions.row(positions.rows() - 1)[2] - 0.01).abs() <= 1e-6);
}
