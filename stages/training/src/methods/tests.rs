//! Tests of every registered method: its registration, and its f64 gradients against central differences.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use shaders::check::noise;
use shaders::tape::{Device, Tape, Tensor};

use super::*;
use crate::clock::{ClockReading, PhaseClock};
use crate::data::{Dataset, Streams, Supplements, TrainingView, ViewConstants};
use crate::effects::{Effects, Need, SEED_FROM_MASKS, saves_time};
use crate::method::{LossUnits, Moment, Recorded, SILHOUETTE, Start, Step, StepOutcome, raster_settings, run_step};
use crate::model::ModelState;
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;

/// Step of the central differences, at which truncation (1e-12) and rounding (1e-10) stay below [`TOLERANCE`].
const STEP: f64 = 1e-6;
/// Tolerance relative to the tensor's largest gradient, which is at least [`FLOOR`] of the largest of all tensors.
const TOLERANCE: f64 = 2e-5;
/// Gradients below this share of the largest gradient of all are lost in the rounding of the loss.
const FLOOR: f64 = 1e-4;
/// Compared elements per tensor.
const SAMPLES: usize = 10;

/// A method in f64 in the middle of a phase.
struct Case {
    method: Box<dyn Method<f64>>,
    params: TrainingParams,
    dataset: Dataset,
    supplements: Supplements,
    phase: &'static str,
    state: ModelState<f64>,
    view: TrainingView<f64>,
    units: LossUnits,
    _dir: tempfile::TempDir,
}

impl Case {
    /// The state at the start of `phase` with every value perturbed, so that no value is at a singular point.
    fn new(entry: &Registration, phase_index: usize) -> Self {
        Self::with(entry, phase_index, |_| ())
    }

    /// The perturbed state at the start of a phase, for changed parameters.
    fn with(entry: &Registration, phase_index: usize, change: impl FnOnce(&mut Shared)) -> Self {
        Self::perturbed(entry, phase_index, change, 0.1)
    }

    /// The state at the start of a phase with every value perturbed by up to this amount, for changed parameters.
    fn perturbed(
        entry: &Registration,
        phase_index: usize,
        change: impl FnOnce(&mut Shared),
        perturbation: f64,
    ) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let test_scene = TestScene { size: 16, ..TestScene::default() };
        let dataset = Dataset::load(test_scene.write(dir.path()), 1).unwrap();
        let mut params = TrainingParams::of(entry.name).unwrap();
        params.settings = (entry.tiny_settings)();
        params.shared.loss.lambda_dssim = 0.2;
        params.shared.initial_points.max_count = 8;
        change(&mut params.shared);
        let method = entry.build_f64(&params.shared, &params.settings).unwrap();
        let points = dataset.initial_points(&params.shared.initial_points, 0).unwrap();
        let supplements = test_scene.supplements(&dataset);
        let start = Start { dataset: &dataset, supplements: &supplements };
        let random = Streams::new(1);
        let phases = method.phases();
        let mut state = method.initialize(&start, &points, random).unwrap();
        for phase in &phases[..=phase_index] {
            state = method.enter_phase(phase.name, state, &start, random).unwrap();
        }
        let mut moved = ModelState::new();
        for (index, (name, tensor)) in state.iter().enumerate() {
            let learnt = method.learning_rate(phases[phase_index].name, name, &dataset.scene).is_some();
            let amount = if learnt { perturbation } else { 0.0 };
            let shifts = noise(tensor.len(), index as u64);
            let values = tensor.as_slice().iter().zip(shifts).map(|(value, shift)| value + amount * shift).collect();
            moved.insert(name, Tensor::from_vec(tensor.shape(), values));
        }
        let view = dataset.train[3].to_training();
        let (phase, units) = (
            phases[phase_index].name,
            LossUnits::ones(entry.losses.iter().map(|loss| loss.name).chain(["spread of depth"])),
        );
        Self { method, params, phase, state: moved, view, units, dataset, supplements, _dir: dir }
    }

    fn view_moment(&self, sh_degree: usize) -> Moment<'_> {
        let Self { dataset, view, phase, .. } = self;
        Moment { scene: &dataset.scene, phase, time: view.time, camera: &view.camera, sh_degree, left_out: None }
    }

    fn learns(&self, name: &str) -> bool {
        self.method.learning_rate(self.phase, name, &self.dataset.scene).is_some()
    }

    /// The losses of one step and the gradients of all learnt tensors.
    fn evaluate(&self, state: &ModelState<f64>) -> (f64, BTreeMap<String, Tensor<f64>>) {
        self.evaluate_on(&mut Tape::new(Device::Cpu), state)
    }

    fn evaluate_on(&self, tape: &mut Tape<f64>, state: &ModelState<f64>) -> (f64, BTreeMap<String, Tensor<f64>>) {
        let model = state.bind(tape, |name| self.learns(name));
        let degree = self.params.shared.harmonics.degree;
        let mut raster = raster_settings(&self.dataset.scene, degree);
        raster.smooth_cutoff = true;
        let step = Step {
            tape,
            model: &model,
            views: std::slice::from_ref(&self.view),
            scene: &self.dataset.scene,
            dataset: &self.dataset,
            supplements: &self.supplements,
            shared: &self.params.shared,
            phase: self.phase,
            iteration: 1,
            sh_degree: degree,
            harmonics_intervals: 9,
            raster,
            random: Streams::new(2).step("fine", 1),
            clock: &mut PhaseClock::start("test", ClockReading::default()),
            constants: &ViewConstants::default(),
            units: &self.units,
            recorded: Recorded::default(),
        };
        let mut outcome: StepOutcome<f64> = run_step(&*self.method, step).unwrap();
        let total = outcome.total();
        let take = |(name, var): (&str, _)| Some((name.to_string(), outcome.gradients.take(var)?));
        (total, model.iter().filter_map(take).collect())
    }

    /// The number of operations in the forward pass of one step, and its loss.
    fn operations(&self) -> (usize, f64) {
        let mut tape = Tape::new(Device::Cpu);
        let (loss, _) = self.evaluate_on(&mut tape, &self.state);
        (tape.profile().ops.values().map(|cost| cost.forward.calls as usize).sum(), loss)
    }

    /// The values that the losses detach from the model, in order.
    fn detached(&self) -> Vec<Tensor<f64>> {
        let mut tape = Tape::new(Device::Cpu);
        self.evaluate_on(&mut tape, &self.state);
        tape.detached().to_vec()
    }

    /// The loss with one element of one tensor perturbed and the detached values unchanged.
    fn loss_with(&self, detached: &[Tensor<f64>], name: &str, element: usize, shift: f64) -> f64 {
        let mut state = self.state.clone();
        let mut tensor = state.get(name).unwrap().clone();
        tensor.make_mut()[element] += shift;
        state.insert(name, tensor);
        self.evaluate_on(&mut Tape::replaying(Device::Cpu, detached), &state).0
    }

    /// Compares a few elements of every trained tensor with central differences; the error names the first mismatch.
    fn check_gradients(&self, found: &BTreeMap<String, Tensor<f64>>) -> Result<(), String> {
        let largest = |tensor: &Tensor<f64>| tensor.as_slice().iter().fold(0.0_f64, |a, value| a.max(value.abs()));
        let overall = found.values().map(largest).fold(0.0, f64::max);
        let detached = self.detached();
        for (name, gradient) in found {
            let allowed = TOLERANCE * largest(gradient).max(FLOOR * overall);
            let stride = gradient.len().div_ceil(SAMPLES).max(1);
            for element in (0..gradient.len()).step_by(stride) {
                let loss_at = |shift| self.loss_with(&detached, name, element, shift);
                let difference = loss_at(STEP) - loss_at(-STEP);
                let (expected, found) = (difference / (2.0 * STEP), gradient.as_slice()[element]);
                if !((found - expected).abs() <= allowed) {
                    return Err(format!(
                        "{name}[{element}] is {found:e} instead of {expected:e} (allowed {allowed:e})"
                    ));
                }
            }
        }
        Ok(())
    }
}

fn cases() -> Vec<(String, Case)> {
    let mut cases = Vec::new();
    for entry in registry() {
        let params = TrainingParams::of(entry.name).unwrap();
        let phases = entry.build_f64(&params.shared, &params.settings).unwrap().phases();
        for (index, phase) in phases.iter().enumerate() {
            cases.push((format!("{} in {}", entry.name, phase.name), Case::new(entry, index)));
        }
    }
    cases
}

#[test]
fn every_gradient_agrees_with_central_differences() {
    for (name, case) in cases() {
        let (_, gradients) = case.evaluate(&case.state);
        case.check_gradients(&gradients).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

#[test]
fn gradients_of_effects_that_are_off_by_default_agree_with_central_differences() {
    for entry in registry() {
        let effects = entry.effects();
        for added in effects.iter().filter(|effect| !effect.by_default && effect.name != SEED_FROM_MASKS.name) {
            let on = effects.iter().filter(|effect| effect.by_default || effect.name == added.name);
            let on: BTreeSet<String> = on.map(|effect| effect.name.to_owned()).collect();
            let params = TrainingParams::of(entry.name).unwrap();
            let phases = entry.build_f64(&params.shared, &params.settings).unwrap().phases();
            let case = Case::with(entry, phases.len() - 1, |shared| shared.effects = Effects::Named(on));
            let (_, gradients) = case.evaluate(&case.state);
            case.check_gradients(&gradients).unwrap_or_else(|error| panic!("{} +{}: {error}", entry.name, added.name));
        }
    }
}

/// A method with seeds on every `stride`-th pixel at the start of its last phase.
fn seeded(entry: &Registration, stride: usize, silhouette: f64, perturbation: f64) -> Case {
    let on = entry.effects().into_iter().filter(|effect| effect.by_default).map(|effect| effect.name);
    let on: BTreeSet<String> = on.chain([SEED_FROM_MASKS.name]).map(String::from).collect();
    let change = |shared: &mut Shared| {
        shared.effects = Effects::Named(on);
        shared.seeds.pixel_stride = stride;
        shared.seeds.silhouette = silhouette;
    };
    let params = TrainingParams::of(entry.name).unwrap();
    let phases = entry.build_f64(&params.shared, &params.settings).unwrap().phases();
    Case::perturbed(entry, phases.len() - 1, change, perturbation)
}

/// The methods with the effect `seed-from-masks`.
fn with_seeds() -> impl Iterator<Item = &'static Registration> {
    registry().iter().filter(|entry| entry.effects().iter().any(|other| other.name == SEED_FROM_MASKS.name))
}

#[test]
fn gradients_with_seeds_agree_with_central_differences() {
    for entry in with_seeds() {
        let case = seeded(entry, 4, 0.4, 0.1);
        let (_, gradients) = case.evaluate(&case.state);
        case.check_gradients(&gradients).unwrap_or_else(|error| panic!("{}: {error}", entry.name));
    }
}

#[test]
fn silhouettes_of_seeds_are_compared_with_the_mask() {
    for entry in with_seeds() {
        // Unperturbed, because a perturbed motion model carries seeds out of the view.
        let cases = [0.0, 0.4].map(|weight| seeded(entry, 1, weight, 0.0));
        let [without, with] = cases.each_ref().map(|case| case.evaluate(&case.state));
        let has_loss = entry.losses.contains(&SILHOUETTE);
        assert_eq!(with.0 > without.0, has_loss, "{}: {} and {}", entry.name, without.0, with.0);
        let moves_opacity = with.1.iter().any(|(name, gradient)| {
            name.ends_with(".opacity_logits") && without.1.get(name).is_none_or(|other| other != gradient)
        });
        assert_eq!(moves_opacity, has_loss, "{}: the gradients of opacities", entry.name);
    }
}

#[test]
fn a_wrong_gradient_is_noticed() {
    let case = Case::new(find("static3dgs").unwrap(), 0);
    let (_, gradients) = case.evaluate(&case.state);
    for (name, wrong) in [("gaussians.positions", 1.001), ("gaussians.sh_dc", f64::NAN)] {
        let mut gradients = gradients.clone();
        let gradient = gradients.get_mut(name).unwrap();
        gradient.make_mut().iter_mut().for_each(|value| *value *= wrong);
        assert!(case.check_gradients(&gradients).is_err(), "{name} times {wrong} passed");
    }
}

#[test]
fn every_learnt_tensor_receives_a_gradient() {
    for (name, case) in cases() {
        let (_, gradients) = case.evaluate(&case.state);
        for tensor in case.state.names().filter(|tensor| case.learns(tensor)) {
            let gradient = gradients.get(tensor).unwrap_or_else(|| panic!("{name}: no gradient reaches {tensor}"));
            assert!(gradient.as_slice().iter().any(|value| *value != 0.0), "{name}: the gradient of {tensor} is zero");
        }
    }
}

#[test]
fn every_readme_states_its_equations_and_departures() {
    for entry in registry() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/methods").join(entry.name).join("README.md");
        let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let has = |heading: &str| text.lines().any(|line| line.strip_prefix("## ") == Some(heading));
        let has_decisions = has("What the paper leaves open") || has("Departures");
        assert!(text.starts_with(&format!("# {}\n", entry.name)), "{}: the title is not its name", entry.name);
        assert!(has("Equations") && has_decisions, "{}: a section is missing", entry.name);
    }
}

#[test]
fn unused_sources_are_all_other_method_folders() {
    for entry in registry() {
        let unused = unused_sources(entry.name);
        assert_eq!(unused["training"].len(), registry().len() - 1);
        assert!(unused["training"].iter().all(|path| !path.ends_with(entry.name)));
        let stage = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert!(unused["training"].iter().all(|path| stage.join(path).is_dir()));
        assert!(unused["shaders"].iter().all(|path| stage.join("../../shaders").join(path).is_dir()));
    }
}

/// The cost of a training (optional inputs read, trained values, operations of one step in each phase), and its loss.
fn cost(entry: &Registration, on: &BTreeSet<String>) -> ([usize; 3], f64) {
    let change = |shared: &mut Shared| {
        if !on.contains(VIEW_DEPENDENT_COLOR.name) {
            shared.harmonics.degree = 0;
        }
        shared.effects = Effects::Named(on.clone());
    };
    let mut params = TrainingParams::of(entry.name).unwrap();
    params.settings = (entry.tiny_settings)();
    change(&mut params.shared);
    let phases = entry.build_f64(&params.shared, &params.settings).unwrap().phases().len();
    let needed = entry.effects().into_iter().filter(|effect| on.contains(effect.name));
    let ports: BTreeSet<&str> = needed.flat_map(|effect| effect.needs).filter_map(|need| need.port()).collect();
    let (mut cost, mut losses) = ([ports.len(), 0, 0], 0.0);
    for index in 0..phases {
        let case = Case::with(entry, index, change);
        let learnt = case.state.iter().filter(|(name, _)| case.learns(name));
        cost[1] += learnt.map(|(_, tensor)| tensor.len()).sum::<usize>();
        let (operations, loss) = case.operations();
        cost[2] += operations;
        losses += loss;
    }
    (cost, losses)
}

#[test]
fn disabled_effects_cost_nothing() {
    let mut complaints = Vec::new();
    for entry in registry() {
        // Effects that save time are compared with a training without them in `trainer/speed_tests.rs`.
        let effects: Vec<Effect> = entry.effects().into_iter().filter(|effect| !saves_time(effect)).collect();
        let all: BTreeSet<String> = effects.iter().map(|effect| effect.name.to_owned()).collect();
        let (full, full_loss) = cost(entry, &all);
        for effect in &effects {
            let mut rest = all.clone();
            rest.remove(effect.name);
            // Effects that need the removed one are removed, too.
            for other in &effects {
                if other.needs.iter().any(|need| matches!(need, Need::Effect(name) if !rest.contains(*name))) {
                    rest.remove(other.name);
                }
            }
            let (without, loss) = cost(entry, &rest);
            // Without an effect, other parts may do more work (without a static layer everything is dynamic), but some
            // cost must be lower; or, at equal cost, the loss must differ.
            let saves = without.iter().zip(&full).any(|(without, full)| without < full);
            if !saves && (without != full || loss == full_loss) {
                complaints.push(format!("{} without {}: {without:?} after {full:?}", entry.name, effect.name));
            }
        }
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn unknown_methods_are_refused_with_the_known_names() {
    let error = find("nerf").err().unwrap();
    assert_eq!(error.got, "nerf");
    assert!(error.known.contains(&"deformable4dgs") && error.to_string().contains("deformable4dgs"));
}

#[test]
fn rows_are_unique_and_cover_every_splat() {
    for (name, case) in cases() {
        let mut tape = Tape::new(Device::Cpu);
        let model = case.state.bind(&mut tape, |_| false);
        let degree = case.params.shared.harmonics.degree;
        let moment = case.view_moment(degree);
        let splats = case.method.splats(&mut tape, &model, &moment).unwrap();
        let Some(rows) = case.method.rows(&mut tape, &model, &moment).unwrap() else { continue };
        assert_eq!(rows.len(), tape.value(splats.positions).rows(), "{name}");
        assert!(rows.is_sorted_by(|a, b| a < b), "{name}: rows repeat or are out of order");
    }
}
