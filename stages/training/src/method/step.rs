//! One training step: its interface for methods, and its forward and backward pass, in any precision.

use std::collections::BTreeMap;
use std::sync::Arc;

use shaders::losses::l1::l1_dssim;
use shaders::pointwise::mul;
use shaders::rasteriser::{self, RasterSettings, Rendered, SplatVars};
use shaders::tape::{Gradients, Real, Tape, Tensor, Var, first_elements};

use super::attention::{Attention, SEED_LIVES, attention, leaves_out_own, masked_l1};
use super::loss_units::LossUnits;
use super::named_loss::NamedLoss;
use super::{Method, Moment, too_large};
use crate::artifact::PHOTOMETRIC;
use crate::clock::{LOSSES, PhaseClock};
use crate::data::{Dataset, SceneFacts, StepRandom, Supplements, TrainingView, ViewConstants};
use crate::model::Variables;
use crate::shared::Shared;

/// Maps the splats of one render to rows of a population, for methods that spawn splats per render (anchors).
#[derive(Clone, Debug)]
pub(crate) struct SplatRows {
    /// The population's name, e.g. `anchors`.
    pub population: &'static str,
    /// The number of rows.
    pub count: usize,
    /// [M] the row of each splat, each row at most once; `None`: all rows in order.
    pub row_of_splat: Option<Arc<Vec<u32>>>,
    /// The parents of the rows.
    pub parents: ParentVars,
}

/// Values of one render about the N parents of its splats, each of which owns equally many rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ParentVars {
    /// [N, 1]: 1 where the parent lies in the view, drawn or not, otherwise 0.
    pub in_view: Var,
    /// [N, 1]: the sum of the opacities of the parent's splats.
    pub opacity: Var,
}

/// The rows of a population that a render shows, for the step hooks that observe the population.
pub(crate) enum Observed<'p> {
    /// No population.
    Nothing,
    /// All splats are the rows of this population, in order.
    All(&'p str),
    /// The first splats, this many, are the rows of this population.
    First(&'p str, usize),
    /// The splats are these rows.
    Rows(SplatRows),
}

/// A render whose screen-space gradients drive a population.
pub(crate) struct RenderRecord {
    /// The population's name.
    pub population: String,
    /// The render.
    pub rendered: Rendered,
    /// Width and height of the image.
    pub size_px: [f64; 2],
    /// Rows of the population.
    pub count: usize,
    /// The row of each splat; `None`: the first `count` splats are all rows in order.
    pub rows: Option<SplatRows>,
}

/// One training step: the inputs of a method's losses and the recorder of its results.
pub(crate) struct Step<'a, T: Real> {
    /// Records every operation.
    pub tape: &'a mut Tape<T>,
    /// The model's tensors on the tape.
    pub model: &'a Variables,
    /// The views drawn for this step.
    pub views: &'a [TrainingView<T>],
    /// The scene.
    pub scene: &'a SceneFacts,
    /// All training views, for losses that need more than the views of this step.
    pub dataset: &'a Dataset,
    /// The optional inputs.
    pub supplements: &'a Supplements,
    /// The tables that every method understands.
    pub shared: &'a Shared,
    /// The phase's name.
    pub phase: &'a str,
    /// Counted from 1 within the phase.
    pub iteration: u64,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Intervals of `harmonics` that have passed in this phase, also after the last degree.
    pub harmonics_intervals: u64,
    /// Settings of the rasteriser for the renders of the step.
    pub raster: RasterSettings,
    /// Random numbers, by purpose.
    pub random: StepRandom,
    /// Attributes the time of the step to activities.
    pub clock: &'a mut PhaseClock,
    /// Constant tensors of views on the step's device.
    pub(crate) constants: &'a ViewConstants<T>,
    /// The known units of losses.
    pub(crate) units: &'a LossUnits,
    /// The losses, renders and work counters recorded so far.
    pub(crate) recorded: Recorded,
}

/// The losses, renders and work counters that a method records during a step.
#[derive(Default)]
pub(crate) struct Recorded {
    losses: Vec<NamedLoss>,
    unmeasured: Vec<NamedLoss>,
    renders: Vec<RenderRecord>,
    skipped: SkippedWork,
    deferred: Vec<DeferredWork>,
    measured: Vec<(&'static str, Var)>,
}

/// A work counter whose value only the device knows: its name, a scalar with the amount processed, the total amount.
type DeferredWork = (&'static str, Var, usize);

/// Work left out because it could not change the result, by name: the amount left out and the total amount.
pub(crate) type SkippedWork = BTreeMap<&'static str, [u64; 2]>;

impl<'a, T: Real> Step<'a, T> {
    /// The moment at which a view of this step shows the model.
    pub(crate) fn moment(&self, view: &'a TrainingView<T>) -> Moment<'a> {
        Moment {
            scene: self.scene,
            phase: self.phase,
            time: view.time,
            camera: &view.camera,
            sh_degree: self.sh_degree,
            left_out: leaves_out_own(self.iteration).then_some(view.time),
        }
    }

    /// Renders splats, and their `features` [N, F] if given, into a view. The screen-space gradients of the render
    /// drive the `observed` population.
    pub(crate) fn render(
        &mut self,
        splats: &SplatVars,
        features: Option<Var>,
        view: &TrainingView<T>,
        observed: Observed<'_>,
    ) -> anyhow::Result<Rendered> {
        self.clock.enter("render");
        let rendered =
            rasteriser::render(self.tape, splats, features, &view.camera, &self.raster).map_err(too_large)?;
        self.clock.enter(LOSSES);
        let (population, count, rows) = match observed {
            Observed::Nothing => return Ok(rendered),
            Observed::All(population) => (population, rendered.splats(self.tape), None),
            Observed::First(population, count) => (population, count, None),
            Observed::Rows(rows) => (rows.population, rows.count, Some(rows)),
        };
        self.recorded.renders.push(RenderRecord {
            population: population.into(),
            rendered: rendered.clone(),
            size_px: [view.camera.width as f64, view.camera.height as f64],
            count,
            rows,
        });
        Ok(rendered)
    }

    /// `weight` times (1 − λ)·L1 + λ·(1 − SSIM) of a render against its view's image, averaged over the step's views.
    ///
    /// With the effect `seed-from-masks`, moving pixels are ignored in a static warm-up and have a higher weight later.
    pub(crate) fn photometric(&mut self, weight: f64, color: Var, view: &TrainingView<T>) {
        let target = self.tape.constant(view.image.clone());
        self.photometric_of(weight, color, target, view);
    }

    /// [`Step::photometric`] with `target` in place of the view's image.
    pub(crate) fn photometric_of(&mut self, weight: f64, color: Var, target: Var, view: &TrainingView<T>) {
        let (moving, is_seeded) = (self.supplements.moving(view.index), self.model.find(SEED_LIVES).is_some());
        match attention(moving, view, self.shared, self.phase, is_seeded) {
            Attention::Even => self.photometric_to(weight, color, target),
            Attention::Hidden(weights) => {
                let weights = self.tape.constant(weights);
                let [color, target] = [color, target].map(|image| mul(self.tape, image, weights));
                self.photometric_to(weight, color, target);
            }
            Attention::Raised(weights, reciprocal_share) => {
                self.photometric_to(weight, color, target);
                let value = masked_l1(self.tape, [color, target], weights);
                let weight = weight * self.shared.seeds.weight * reciprocal_share / self.views.len() as f64;
                self.add_loss(PHOTOMETRIC, weight, value);
            }
        }
    }

    /// [`Step::photometric`] against another image, in which all pixels have the same weight.
    pub(crate) fn photometric_to(&mut self, weight: f64, color: Var, target: Var) {
        let value = l1_dssim(self.tape, color, target, self.shared.loss.lambda_dssim);
        self.add_loss(PHOTOMETRIC, weight / self.views.len() as f64, value);
    }

    /// Counts work that was left out, e.g. `("motion of static Gaussians", 900, 1000)`.
    pub(crate) fn count_skipped(&mut self, what: &'static str, skipped: usize, of: usize) {
        add_skipped(&mut self.recorded.skipped, what, [skipped as u64, of as u64]);
    }

    /// Counts work whose processed amount is the scalar `processed` on the device; the step does not read it back.
    pub(crate) fn count_skipped_deferred(&mut self, what: &'static str, processed: Var, of: usize) {
        self.recorded.deferred.push((what, processed, of));
    }

    /// Shows a value of the step to the hooks that observe it ([`StepHook::observe_value`](super::StepHook)).
    pub(crate) fn measure(&mut self, name: &'static str, value: Var) {
        self.recorded.measured.push((name, value));
    }

    /// Adds `weight` · `value` to the objective, unless the training leaves this loss out.
    pub(crate) fn add_loss(&mut self, name: &'static str, weight: f64, value: Var) {
        self.add_losses(&[(name, weight, value)]);
    }

    /// Measures the unit of the loss that contains `weight` · `value` ([`LossUnits`]). The objective does not change.
    pub(crate) fn measure_unit(&mut self, name: &'static str, weight: f64, value: Var) {
        self.recorded.unmeasured.push(NamedLoss { name, weight, value });
    }

    /// [`Step::add_loss`] for losses that are evaluated together; the clock divides their time equally among them.
    pub(crate) fn add_losses(&mut self, losses: &[(&'static str, f64, Var)]) {
        let names: Vec<&str> = losses.iter().map(|(name, ..)| *name).collect();
        self.clock.charge(&names);
        let kept = losses.iter().filter(|(name, ..)| self.shared.without != *name);
        self.recorded.losses.extend(kept.map(|&(name, weight, value)| NamedLoss { name, weight, value }));
    }
}

/// The result of a step: its losses, its gradients and its renders.
pub(crate) struct StepOutcome<T: Real> {
    /// Every loss, in the order of recording.
    pub losses: Vec<NamedLoss>,
    /// Losses outside the objective whose unit is not known yet.
    pub unmeasured: Vec<NamedLoss>,
    /// Name, weight and value of every loss.
    pub values: Vec<(&'static str, f64, Tensor<T>)>,
    /// Gradients of the sum of the weighted losses with respect to everything on the tape.
    pub gradients: Gradients<T>,
    /// Work left out, as far as the host knows it.
    pub skipped: SkippedWork,
    /// Work counted on the device: name, scalar with the amount processed, total amount.
    pub deferred: Vec<(&'static str, Tensor<T>, usize)>,
    /// Renders that drive populations.
    pub renders: Vec<RenderRecord>,
    /// Values for the hooks, by name.
    pub measured: Vec<(&'static str, Var)>,
}

/// Evaluates a method's losses on a step and differentiates their sum.
pub(crate) fn run_step<T: Real>(method: &dyn Method<T>, mut step: Step<'_, T>) -> anyhow::Result<StepOutcome<T>> {
    method.losses(&mut step)?;
    step.clock.enter("backward");
    let Step { tape, recorded: Recorded { losses, unmeasured, renders, skipped, deferred, measured }, .. } = step;
    let seeds: Vec<_> = losses.iter().map(|loss| loss.seed(tape)).collect();
    let gradients = tape.backward(&seeds);
    let value = |loss: &NamedLoss| (loss.name, loss.weight, tape.value(loss.value).clone());
    let values = losses.iter().map(value).collect();
    let deferred = deferred.iter().map(|&(what, var, of)| (what, tape.value(var).clone(), of)).collect();
    Ok(StepOutcome { losses, unmeasured, values, gradients, skipped, deferred, renders, measured })
}

impl<T: Real> StepOutcome<T> {
    /// Weighted losses by name, summed over views, and all work left out. Waits for the device.
    pub(crate) fn read_back(&self) -> (BTreeMap<&'static str, f64>, SkippedWork) {
        let losses = self.values.iter().map(|(.., value)| value);
        let tensors: Vec<&Tensor<T>> = losses.chain(self.deferred.iter().map(|(_, value, _)| value)).collect();
        let mut values = first_elements(&tensors).into_iter().map(T::to_f64);
        let weights = self.values.iter().map(|(name, weight, _)| (*name, *weight));
        let losses = sum_by_name(weights.zip(values.by_ref()));
        let mut skipped = self.skipped.clone();
        for ((what, _, of), processed) in self.deferred.iter().zip(values) {
            add_processed(&mut skipped, what, processed, *of);
        }
        (losses, skipped)
    }

    /// Weighted losses by name, summed over views. Waits for the device.
    #[cfg(test)]
    pub(crate) fn losses(&self) -> BTreeMap<&'static str, f64> {
        self.read_back().0
    }

    /// The sum of the weighted losses. Waits for the device.
    #[cfg(test)]
    pub(crate) fn total(&self) -> f64 {
        self.losses().values().sum()
    }
}

/// Adds a pair of amounts, left out and total, to a work counter.
fn add_skipped(skipped: &mut SkippedWork, what: &'static str, [left_out, of]: [u64; 2]) {
    let count = skipped.entry(what).or_default();
    count[0] += left_out;
    count[1] += of;
}

/// Adds to a work counter, given the processed part of a total; `processed` is a whole number up to rounding.
pub(crate) fn add_processed(skipped: &mut SkippedWork, what: &'static str, processed: f64, of: usize) {
    add_skipped(skipped, what, [of as u64 - processed.round() as u64, of as u64]);
}

/// Weighted values summed by name.
pub(crate) fn sum_by_name(losses: impl Iterator<Item = ((&'static str, f64), f64)>) -> BTreeMap<&'static str, f64> {
    let mut sums = BTreeMap::new();
    losses.for_each(|((name, weight), value)| *sums.entry(name).or_default() += weight * value);
    sums
}
