//! Adaptive density control of Kerbl et al. 2023 (section 5.2, with the constants of the published code).
//!
//! Gradients are with respect to the projected mean in normalised device coordinates, averaged over the steps in which
//! the Gaussian is visible; `batch_gradient` sets what a step of several views adds. Departures: a round uses only
//! statistics from before it (as in the published code, a clone is never split in the same round), the optimizer's
//! step of the same iteration comes first, a hard cap keeps the largest gradients when a round would exceed it, and a
//! round that would empty the model ends all pruning.

use std::borrow::Cow;

use anyhow::Context as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::Deserialize as _;

use super::growth_budget::GrowthBudget;
use super::initial::{INITIAL_OPACITY, logit};
use super::statistics::{GRADIENT_SUM, SEEN_COUNT, Statistics};
use crate::bases::collapse::CollapseGuard;
use crate::method::{AfterStep, Detail, ScreenStats, StepHook, Survey};
use crate::model::Optimizer;
use crate::schedule::stretch;
use crate::shared::{Density, Shared, TemporalPruning, ViewConsistency};

/// Children of a split Gaussian.
const SPLIT_CHILDREN: usize = 2;
/// Late rounds of the effect `view-consistent-density` end after this many times the iterations of growth (published code).
const LATE_END: u64 = 2;
/// Divisor of the children's scales: 0.8 · [`SPLIT_CHILDREN`] (published code).
const SPLIT_SHRINK: f32 = 1.6;

/// Clones, splits and prunes the rows of one population of Gaussians.
#[derive(Clone)]
pub(crate) struct AdaptiveDensity {
    population: String,
    params: Density,
    reset_at_start: bool,
    steps_before: u64,
    dimensions: Dimensions,
    /// Whether all Gaussians are drawn with one common size.
    has_one_size: bool,
    statistics: Statistics,
    guard: CollapseGuard,
    /// With the effect `coarse-to-fine`, the limit on the number of Gaussians; it begins with the first round.
    budget: Option<GrowthBudget>,
    /// With the effect `temporal-pruning`, its rounds; their schedule is already stretched.
    over_time: Option<TemporalPruning>,
    /// With the effect `view-consistent-density`, its criteria; their schedule is already stretched.
    over_views: Option<ViewConsistency>,
}

/// The axes along which the children of a split Gaussian are drawn and shrunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dimensions {
    /// Three: the tensors `rotations`, `positions` and `log_scales`.
    Space,
    /// Four: also `rotations_left`, `rotations_right`, `times` and `log_scales_time` (Yang et al. 2024).
    SpaceTime,
}

/// The actions of density control after one iteration.
struct Round {
    /// Clone and split.
    grows: bool,
    /// Prune, if there are enough Gaussians.
    shrinks: bool,
    /// Reset opacities.
    resets: bool,
}

impl AdaptiveDensity {
    /// Density control of `population` with a schedule stretched by `schedule_scale`. `reset_at_start` resets opacities
    /// once when rounds begin (the published code does so on a white background).
    pub(crate) fn new(population: &str, params: &Density, schedule_scale: f64, reset_at_start: bool) -> Self {
        let params = Density {
            from: stretch(params.from, schedule_scale),
            until: stretch(params.until, schedule_scale),
            opacity_reset_interval: stretch(params.opacity_reset_interval, schedule_scale),
            ..params.clone()
        };
        Self {
            population: population.into(),
            params,
            reset_at_start,
            steps_before: 0,
            dimensions: Dimensions::Space,
            has_one_size: false,
            statistics: Statistics::default(),
            guard: CollapseGuard::default(),
            budget: None,
            over_time: None,
            over_views: None,
        }
    }

    /// Continues the schedule of earlier phases with `steps_before` steps in total.
    pub(crate) fn after(self, steps_before: u64) -> Self {
        Self { steps_before, ..self }
    }

    /// Density control of Gaussians in space and time, whose children are drawn in four dimensions.
    pub(crate) fn in_space_time(self) -> Self {
        Self { dimensions: Dimensions::SpaceTime, ..self }
    }

    /// Density control of Gaussians that are drawn with one common size, the exponential of the mean of `log_scales`.
    pub(crate) fn of_one_size(self) -> Self {
        Self { has_one_size: true, ..self }
    }

    /// Adds the surveys of the effects `temporal-pruning` and `view-consistent-density` if they are on and this is the last
    /// phase. Their iterations are stretched by the schedule scale.
    pub(crate) fn with_surveys(self, shared: &Shared, is_last_phase: bool) -> Self {
        if !is_last_phase {
            return self;
        }
        let over_time = shared.pruning_over_time().map(|rounds| TemporalPruning {
            from: stretch(rounds.from, shared.schedule_scale),
            interval: stretch(rounds.interval, shared.schedule_scale),
            ..rounds.clone()
        });
        let over_views = shared.consistency_of_views().map(|criteria| ViewConsistency {
            late_interval: stretch(criteria.late_interval, shared.schedule_scale),
            ..criteria.clone()
        });
        Self { over_time, over_views, ..self }
    }

    /// The rounds of temporal pruning, if there is one after an iteration of the whole schedule.
    fn round_over_time(&self, iteration: u64) -> Option<&TemporalPruning> {
        let is_due = |rounds: &&TemporalPruning| {
            iteration >= rounds.from && (iteration - rounds.from).is_multiple_of(rounds.interval)
        };
        self.over_time.as_ref().filter(is_due).filter(|_| !self.guard.is_closed())
    }

    /// The survey of errors after an iteration of the whole schedule, if there is one: before cloning and splitting, and
    /// for late pruning once these have ended.
    fn round_over_views(&self, iteration: u64) -> Option<Survey> {
        let ViewConsistency { views, high_error: above, late_interval, .. } = *self.over_views.as_ref()?;
        let until = self.params.until;
        let is_late = iteration >= until;
        let is_due = if is_late {
            let is_round = (iteration - until).is_multiple_of(late_interval) && iteration < LATE_END * until;
            is_round && !self.guard.is_closed() && !self.has_just_reset(iteration, late_interval)
        } else {
            self.round(iteration).grows
        };
        is_due.then_some(Survey::HighError { views, above, by_loss: is_late })
    }

    /// Whether the last reset of opacities before the end of growth was less than half of `interval` before an iteration: all
    /// Gaussians are still faint.
    fn has_just_reset(&self, iteration: u64, interval: u64) -> bool {
        let Density { until, opacity_reset_interval, .. } = self.params;
        let last =
            until.saturating_sub(1).checked_div(opacity_reset_interval).map(|count| count * opacity_reset_interval);
        last.is_some_and(|last| 2 * (iteration - last) < interval)
    }

    /// The actions after an iteration of the whole schedule.
    fn round(&self, iteration: u64) -> Round {
        let Density { interval, from, until, prune_interval, opacity_reset_interval, .. } = self.params;
        let (is_open, has_begun) = (iteration < until, iteration > from);
        let is_reset = iteration.is_multiple_of(opacity_reset_interval) || self.reset_at_start && iteration == from;
        Round {
            grows: is_open && has_begun && iteration.is_multiple_of(interval),
            shrinks: is_open && has_begun && iteration.is_multiple_of(prune_interval),
            resets: is_open && opacity_reset_interval > 0 && is_reset,
        }
    }

    fn tensor<'a>(&self, optimizer: &'a Optimizer, attribute: &str) -> anyhow::Result<&'a [f32]> {
        Ok(optimizer.tensor(&format!("{}.{attribute}", self.population))?.as_slice())
    }

    /// The logarithmic scales with which Gaussians are drawn.
    fn drawn_log_scales<'a>(&self, optimizer: &'a Optimizer) -> anyhow::Result<Cow<'a, [f32]>> {
        let own = self.tensor(optimizer, "log_scales")?;
        let mean = || own.iter().map(|&value| f64::from(value)).sum::<f64>() / own.len().max(1) as f64;
        Ok(if self.has_one_size { Cow::Owned(vec![mean() as f32; own.len()]) } else { Cow::Borrowed(own) })
    }

    /// Clones small and splits large Gaussians whose gradient is above the threshold.
    fn densify(
        &mut self,
        optimizer: &mut Optimizer,
        extent: f64,
        random: &mut ChaCha8Rng,
        detail: Option<Detail>,
    ) -> anyhow::Result<()> {
        let count = optimizer.population_len(&self.population)?;
        let drawn = self.drawn_log_scales(optimizer)?.into_owned();
        let largest = largest_scales(&drawn);
        let chosen = self.candidates(count, detail);
        let split_above = (self.params.split_above * extent) as f32;
        let (split, cloned): (Vec<usize>, Vec<usize>) = chosen.into_iter().partition(|&at| largest[at] > split_above);
        if self.has_one_size {
            // Children are copies of their parents.
            optimizer.edit(&format!("{}.log_scales", self.population), |own| {
                split.iter().for_each(|&at| own[3 * at..][..3].copy_from_slice(&drawn[3 * at..][..3]));
            })?;
        }

        let first_child = count + cloned.len();
        let children: Vec<usize> = split.iter().flat_map(|&parent| [parent; SPLIT_CHILDREN]).collect();
        optimizer.append_copies(&self.population, &[cloned, children.clone()].concat())?;
        self.scatter_children(optimizer, first_child, &children, random)?;
        let total = first_child + children.len();
        let mut keep = vec![true; total];
        split.iter().for_each(|&parent| keep[parent] = false);
        optimizer.keep(&self.population, &keep)?;
        self.statistics.keep(&keep);
        Ok(())
    }

    /// Gaussians above the threshold, in order; only those with the largest gradients if the cap does not allow all of
    /// them.
    fn candidates(&mut self, count: usize, detail: Option<Detail>) -> Vec<usize> {
        let rows = self.statistics.rows();
        let mean = |at: usize| rows[at][GRADIENT_SUM] / rows[at][SEEN_COUNT].max(1.0);
        let threshold = self.params.gradient_threshold as f32;
        let mut chosen: Vec<usize> = (0..rows.len()).filter(|&at| mean(at) >= threshold).collect();
        // Cloning and splitting both add one Gaussian.
        let budget = &mut self.budget;
        let allows = |detail| budget.get_or_insert(GrowthBudget::new(count)).allows(chosen.len(), detail);
        let limit = detail.filter(|detail| detail.limits_growth).map_or(usize::MAX, allows);
        let max_count = self.params.max_count.min(limit);
        let capacity = max_count.saturating_sub(count);
        if chosen.len() > capacity {
            chosen.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
            chosen.truncate(capacity);
            chosen.sort_unstable();
        }
        chosen
    }

    /// Draws the children of split Gaussians from their parents, and shrinks them.
    fn scatter_children(
        &self,
        optimizer: &mut Optimizer,
        first_child: usize,
        parents: &[usize],
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<()> {
        let offsets = match self.dimensions {
            Dimensions::Space => self.offsets(optimizer, parents, random)?,
            Dimensions::SpaceTime => self.offsets_in_space_time(optimizer, parents, random)?,
        };
        let attribute = |name: &str| format!("{}.{name}", self.population);
        optimizer.edit(&attribute("positions"), |positions| {
            for (position, offset) in positions[3 * first_child..].as_chunks_mut::<3>().0.iter_mut().zip(&offsets) {
                *position = (glam::Vec3::from(*position) + offset.truncate()).to_array();
            }
        })?;
        let shrink = |log_scales: &mut [f32]| log_scales.iter_mut().for_each(|value| *value -= SPLIT_SHRINK.ln());
        optimizer.edit(&attribute("log_scales"), |log_scales| shrink(&mut log_scales[3 * first_child..]))?;
        if self.dimensions == Dimensions::SpaceTime {
            optimizer.edit(&attribute("times"), |times| {
                times[first_child..].iter_mut().zip(&offsets).for_each(|(time, offset)| *time += offset.w);
            })?;
            optimizer.edit(&attribute("log_scales_time"), |log_scales| shrink(&mut log_scales[first_child..]))?;
        }
        Ok(())
    }

    /// Draws an offset from the distribution of every parent; zero along the fourth axis.
    fn offsets(
        &self,
        optimizer: &Optimizer,
        parents: &[usize],
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<Vec<glam::Vec4>> {
        let (log_scales, rotations) = (self.tensor(optimizer, "log_scales")?, self.tensor(optimizer, "rotations")?);
        let mut normal = || -> f32 { StandardNormal.sample(random) };
        let mut draw = |&parent: &usize| {
            let scale = glam::Vec3::from_slice(&log_scales[3 * parent..]).exp();
            let along_axes = scale * glam::Vec3::new(normal(), normal(), normal());
            (rotation(&rotations[4 * parent..4 * parent + 4]) * along_axes).extend(0.0)
        };
        Ok(parents.iter().map(&mut draw).collect())
    }

    /// Draws an offset in space and time from the distribution of every parent: p ↦ q_l ⊗ p ⊗ q̄_r of a draw
    /// p = t + xi + yj + zk along the axes.
    fn offsets_in_space_time(
        &self,
        optimizer: &Optimizer,
        parents: &[usize],
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<Vec<glam::Vec4>> {
        let (log_scales, of_time) = (self.tensor(optimizer, "log_scales")?, self.tensor(optimizer, "log_scales_time")?);
        let sides = [self.tensor(optimizer, "rotations_left")?, self.tensor(optimizer, "rotations_right")?];
        let mut normal = || -> f32 { StandardNormal.sample(random) };
        let mut draw = |&parent: &usize| {
            let scale = glam::Vec3::from_slice(&log_scales[3 * parent..]).extend(of_time[parent]).exp();
            let along_axes = scale * glam::Vec4::new(normal(), normal(), normal(), normal());
            let [left, right] = sides.map(|side| rotation(&side[4 * parent..4 * parent + 4]));
            glam::Vec4::from(left * glam::Quat::from_vec4(along_axes) * right.conjugate())
        };
        Ok(parents.iter().map(&mut draw).collect())
    }

    /// The mask of the Gaussians to keep: neither transparent nor, if `sizes_count`, too large. The published code also
    /// compares radii on the screen with 20 px, but sets them to 0 before, so that this rule never applies.
    fn survivors(&self, optimizer: &Optimizer, extent: f64, sizes_count: bool) -> anyhow::Result<Vec<bool>> {
        let largest = largest_scales(&self.drawn_log_scales(optimizer)?);
        let opacities = self.tensor(optimizer, "opacity_logits")?;
        let min_logit = logit(self.params.min_opacity) as f32;
        let max_scale = (self.params.max_scale * extent) as f32;
        let stays = |at: usize| opacities[at] >= min_logit && !(sizes_count && largest[at] > max_scale);
        Ok((0..opacities.len()).map(stays).collect())
    }

    /// The mask of the Gaussians to keep in a round of temporal pruning: all but the share of those with a finite
    /// sensitivity that is least sensitive.
    fn sensitive(&self, iteration: u64, sensitivities: &[f32]) -> Option<Vec<bool>> {
        let rounds = self.over_time.as_ref()?;
        let share = if iteration < self.params.until { rounds.share } else { rounds.late_share };
        let mut by_sensitivity: Vec<usize> = (0..sensitivities.len()).collect();
        by_sensitivity.retain(|&row| sensitivities[row].is_finite());
        by_sensitivity.sort_by(|&a, &b| sensitivities[a].total_cmp(&sensitivities[b]).then(a.cmp(&b)));
        let mut keep = vec![true; sensitivities.len()];
        let removed = (share * by_sensitivity.len() as f64) as usize;
        by_sensitivity[..removed].iter().for_each(|&row| keep[row] = false);
        Some(keep)
    }

    /// Prevents Gaussians with few pixels of high error from growing in this round.
    fn restrict_growth(&mut self, errors: &[f32], detail: Option<Detail>) {
        let Some(criteria) = &self.over_views else { return };
        // A pixel of a reduced image stands for several.
        let pixels = detail.map_or(1, |detail| detail.reduction.pow(2)) as f32;
        let min_error = criteria.min_error_px as f32 / pixels;
        self.statistics.reset_gradients(|at, _| errors[at] < min_error);
    }

    /// The mask of the Gaussians to keep in a late round of view-consistent density: neither faint nor with the largest
    /// errors.
    fn consistent(&self, optimizer: &Optimizer, errors: &[f32]) -> anyhow::Result<Option<Vec<bool>>> {
        let Some(criteria) = &self.over_views else { return Ok(None) };
        let known = errors.iter().copied().filter(|error| error.is_finite());
        let max_error = criteria.late_max_error as f32 * known.fold(0.0, f32::max);
        let min_logit = logit(criteria.late_min_opacity) as f32;
        let logits = self.tensor(optimizer, "opacity_logits")?;
        let stays = |(&logit, &error): (&f32, &f32)| error.is_infinite() || logit >= min_logit && error <= max_error;
        Ok(Some(logits.iter().zip(errors).map(stays).collect()))
    }

    /// Removes all Gaussians but the survivors. If that would empty the model, it removes none, ends all pruning,
    /// restores the initial opacity of fainter Gaussians, and returns a notice.
    fn prune(&mut self, optimizer: &mut Optimizer, keep: &[bool], iteration: u64) -> anyhow::Result<Option<String>> {
        let Some(notice) = self.guard.refuses(&self.population, iteration, keep) else {
            optimizer.keep(&self.population, keep)?;
            self.statistics.keep(keep);
            return Ok(None);
        };
        let name = format!("{}.opacity_logits", self.population);
        let initial = logit(INITIAL_OPACITY) as f32;
        optimizer.edit(&name, |logits| logits.iter_mut().for_each(|value| *value = value.max(initial)))?;
        optimizer.reset_moments(&name)?;
        Ok(Some(notice + ". Fainter ones got their initial opacity back"))
    }

    /// Clamps every opacity to the reset value and resets its moments.
    fn reset_opacity(&self, optimizer: &mut Optimizer) -> anyhow::Result<()> {
        let name = format!("{}.opacity_logits", self.population);
        let ceiling = logit(self.params.opacity_reset_to) as f32;
        optimizer.edit(&name, |logits| logits.iter_mut().for_each(|value| *value = value.min(ceiling)))?;
        optimizer.reset_moments(&name)
    }
}

impl StepHook for AdaptiveDensity {
    fn observes_at(&self, iteration: u64) -> bool {
        self.steps_before + iteration < self.params.until
    }

    fn observe(&mut self, stats: &ScreenStats<'_>) {
        if stats.population == self.population {
            self.statistics.observe_gradient(stats, self.params.batch_gradient.into());
        }
    }

    fn reads_rows_at(&self, iteration: u64) -> bool {
        let Round { grows, shrinks, resets } = self.round(self.steps_before + iteration);
        grows || shrinks || resets || !self.surveys_at(iteration).is_empty()
    }

    fn surveys_at(&self, iteration: u64) -> Vec<Survey> {
        let iteration = self.steps_before + iteration;
        let over_time = self.round_over_time(iteration).map(|rounds| Survey::Sensitivity { views: rounds.views });
        [self.round_over_views(iteration), over_time].into_iter().flatten().collect()
    }

    fn after_step(&mut self, step: AfterStep<'_>) -> anyhow::Result<()> {
        let AfterStep { iteration, optimizer, detail, surveys, scene, random, notices } = step;
        let Density { prune_above_count, opacity_reset_interval, .. } = self.params;
        let iteration = self.steps_before + iteration;
        let Round { grows, shrinks, resets } = self.round(iteration);
        let mut kept = Vec::new();
        for (survey, values) in surveys {
            match survey {
                Survey::HighError { by_loss: false, .. } => self.restrict_growth(&values, detail),
                Survey::HighError { by_loss: true, .. } => kept.extend(self.consistent(optimizer, &values)?),
                Survey::Sensitivity { .. } => kept.extend(self.sensitive(iteration, &values)),
            }
        }
        let both = |a: Vec<bool>, b: Vec<bool>| a.iter().zip(&b).map(|(a, b)| *a && *b).collect();
        if let Some(keep) = kept.into_iter().reduce(both) {
            notices.extend(self.prune(optimizer, &keep, iteration)?);
        }
        if grows {
            self.densify(optimizer, scene.extent, random.of("split"), detail)?;
        }
        if shrinks && !self.guard.is_closed() && optimizer.population_len(&self.population)? > prune_above_count {
            let sizes_count = opacity_reset_interval > 0 && iteration > opacity_reset_interval;
            let keep = self.survivors(optimizer, scene.extent, sizes_count)?;
            notices.extend(self.prune(optimizer, &keep, iteration)?);
        }
        if grows {
            self.statistics = Statistics::default();
        }
        if resets && !self.guard.is_closed() {
            self.reset_opacity(optimizer)?;
        }
        Ok(())
    }

    fn save(&self) -> serde_json::Value {
        serde_json::json!({ "statistics": self.statistics, "guard": self.guard, "budget": self.budget })
    }

    fn restore(&mut self, saved: serde_json::Value) -> anyhow::Result<()> {
        let context = "the density statistics of the checkpoint";
        self.statistics = Statistics::deserialize(&saved["statistics"]).context(context)?;
        self.guard = CollapseGuard::deserialize(&saved["guard"]).context(context)?;
        self.budget = Option::deserialize(&saved["budget"]).context(context)?;
        Ok(())
    }
}

/// The largest standard deviation of each Gaussian.
fn largest_scales(log_scales: &[f32]) -> Vec<f32> {
    log_scales
        .as_chunks::<3>()
        .0
        .iter()
        .map(|row| row.iter().copied().fold(f32::NEG_INFINITY, f32::max).exp())
        .collect()
}

/// The rotation of a raw quaternion (w, x, y, z); the identity for a quaternion of length 0.
fn rotation(wxyz: &[f32]) -> glam::Quat {
    let raw = glam::Quat::from_xyzw(wxyz[1], wxyz[2], wxyz[3], wxyz[0]);
    if raw.length_squared() >= 1e-12 { raw.normalize() } else { glam::Quat::IDENTITY }
}
