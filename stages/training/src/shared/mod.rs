//! The parameters that every method understands, one table per concern. Each table checks its own values.

mod coarse_to_fine;
mod density;
mod initial_points;
mod learning_rates;
mod rendering;
mod seeds;
mod temporal_pruning;
mod view_consistency;

use std::collections::BTreeMap;

use engine::ParamProblem;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::check::{Checks, fields, is_positive};
use crate::effects::{
    COARSE_TO_FINE, Effect, Effects, NOTHING_LEFT_OUT, SEED_FROM_MASKS, TEMPORAL_PRUNING, VIEW_CONSISTENT_DENSITY,
};
use crate::schedule::{Phase, stretch};

pub(crate) use coarse_to_fine::{CoarseToFine, MAX_REDUCTION};
pub(crate) use density::{BatchGradient, Density};
pub(crate) use initial_points::{InitialPoints, PointSource};
pub(crate) use learning_rates::LearningRates;
pub(crate) use rendering::{Curve, Harmonics, Loss};
pub(crate) use seeds::Seeds;
pub(crate) use temporal_pruning::TemporalPruning;
pub(crate) use view_consistency::ViewConsistency;

/// Maximum optimizer steps; a larger product of steps and scale is a typing error.
const MAX_STEPS: f64 = 1e8;

/// Minimum budget: the time that its calibration takes.
const MIN_BUDGET_SECS: f64 = 0.1;

/// Maximum views per step, far beyond any published batch (24).
const MAX_VIEWS: usize = 1024;

/// The parameters that every method understands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Shared {
    /// The seed of every random choice.
    pub seed: u64,
    /// Stretches every schedule (iterations, learning rates, beginning and end of density control, harmonics) by this factor.
    pub schedule_scale: f64,
    /// Training time to aim for, seconds: `schedule_scale` is then calibrated on the machine, and the result is not
    /// reproducible bit for bit. Unset: no limit.
    pub budget_secs: Option<f64>,
    /// Optimizer steps per phase, before stretching.
    pub iterations: BTreeMap<String, u64>,
    /// The phase after which the training ends, so that other trainings can continue from it; unset: the last one.
    pub stop_after: Option<String>,
    /// Views per optimizer step.
    pub batch: usize,
    /// The effects to simulate beyond a static scene.
    pub effects: Effects,
    /// One effect or loss to leave out, to measure its contribution; `nothing` for a whole training. An axis `without =
    /// "all"` has one cell for each effect and loss that acts; the others are dropped from the plan.
    pub without: String,
    /// The points of the first Gaussians.
    pub initial_points: InitialPoints,
    /// The Gaussians of the effect `seed-from-masks`.
    pub seeds: Seeds,
    /// Spherical harmonics.
    pub harmonics: Harmonics,
    /// The photometric loss.
    pub loss: Loss,
    /// Learning rates of the Gaussians' attributes.
    pub learning_rates: LearningRates,
    /// Adaptive density control.
    pub density: Density,
    /// The resolution schedule of the effect `coarse-to-fine`.
    pub coarse_to_fine: CoarseToFine,
    /// The rounds of the effect `temporal-pruning`.
    pub temporal_pruning: TemporalPruning,
    /// The criteria of the effect `view-consistent-density`.
    pub view_consistency: ViewConsistency,
    /// The quality curve.
    pub curve: Curve,
}

impl Shared {
    /// Whether Gaussians of moving subjects are seeded.
    pub(crate) fn has_seeds(&self) -> bool {
        self.is_opted_in(&SEED_FROM_MASKS)
    }

    /// Whether an effect that has to be named explicitly is on. The unresolved automatic choice counts as off.
    fn is_opted_in(&self, effect: &Effect) -> bool {
        self.effects != Effects::Auto && self.effects.has(effect.name)
    }

    /// The resolution schedule, if the effect is on.
    pub(crate) fn resolution_schedule(&self) -> Option<&CoarseToFine> {
        self.is_opted_in(&COARSE_TO_FINE).then_some(&self.coarse_to_fine)
    }

    /// The rounds of temporal pruning, if the effect is on.
    pub(crate) fn pruning_over_time(&self) -> Option<&TemporalPruning> {
        self.is_opted_in(&TEMPORAL_PRUNING).then_some(&self.temporal_pruning)
    }

    /// The criteria of density control over several views, if the effect is on.
    pub(crate) fn consistency_of_views(&self) -> Option<&ViewConsistency> {
        self.is_opted_in(&VIEW_CONSISTENT_DENSITY).then_some(&self.view_consistency)
    }

    /// A phase with the number of steps that the recipe gives it, stretched by the schedule scale.
    pub(crate) fn phase(&self, name: &'static str) -> Phase {
        Phase { name, iterations: stretch(self.iterations_of(name), self.schedule_scale) }
    }

    /// The steps of a phase before stretching.
    pub(crate) fn iterations_of(&self, phase: &str) -> u64 {
        self.iterations.get(phase).copied().unwrap_or(0)
    }
}

impl Default for Shared {
    fn default() -> Self {
        Self {
            seed: 0,
            schedule_scale: 1.0,
            budget_secs: None,
            iterations: BTreeMap::new(),
            stop_after: None,
            batch: 1,
            effects: Effects::Auto,
            without: NOTHING_LEFT_OUT.into(),
            initial_points: InitialPoints::default(),
            seeds: Seeds::default(),
            harmonics: Harmonics::default(),
            loss: Loss::default(),
            learning_rates: LearningRates::default(),
            density: Density::default(),
            coarse_to_fine: CoarseToFine::default(),
            temporal_pruning: TemporalPruning::default(),
            view_consistency: ViewConsistency::default(),
            curve: Curve::default(),
        }
    }
}

impl Shared {
    /// The problems that types cannot express, given the defaults of the method `method`.
    pub(crate) fn problems(&self, method: &str, defaults: &Self) -> Vec<ParamProblem> {
        let phases = &defaults.iterations;
        let known = || format!("{method} has the phases {}", phases.keys().cloned().collect::<Vec<_>>().join(", "));
        let planned = self.iterations.values().fold(0.0, |sum, &steps| sum + steps as f64);
        let steps = planned * self.schedule_scale;
        let has_scale = is_positive(self.schedule_scale) && is_positive(planned);
        let has_budget = |secs: f64| secs >= MIN_BUDGET_SECS && secs.is_finite();
        let constant_colors = format!("must be 0: {method} has no view-dependent colours");
        Checks::default()
            .require("iterations", self.iterations.keys().all(|phase| phases.contains_key(phase)), known())
            .require("iterations", self.iterations.values().any(|&steps| steps > 0), "no phase has any steps")
            .each(fields!(self, schedule_scale), is_positive, "must be positive")
            .require(
                "budget_secs",
                self.budget_secs.is_none_or(has_budget),
                format!("must be at least {MIN_BUDGET_SECS} s"),
            )
            .require("schedule_scale", !has_scale || steps >= 1.0, format!("{steps:.1e} iterations are less than one"))
            .require(
                "schedule_scale",
                !(steps > MAX_STEPS),
                format!("{steps:e} iterations are more than {MAX_STEPS:e}"),
            )
            .counts(MAX_VIEWS, fields!(self, batch))
            .require("harmonics.degree", self.harmonics.degree == 0 || defaults.harmonics.degree > 0, constant_colors)
            .table("harmonics", &self.harmonics)
            .table("initial_points", &self.initial_points)
            .table("seeds", &self.seeds)
            .table("loss", &self.loss)
            .table("learning_rates", &self.learning_rates)
            .table("density", &self.density)
            .table("coarse_to_fine", &self.coarse_to_fine)
            .table("temporal_pruning", &self.temporal_pruning)
            .table("view_consistency", &self.view_consistency)
            .table("curve", &self.curve)
            .problems
    }
}

/// Deserialises a table whose missing keys take their values from `defaults` instead of the type's own defaults.
pub(crate) fn over_defaults<'de, S: Serialize + DeserializeOwned, D: Deserializer<'de>>(
    defaults: &S,
    deserializer: D,
) -> Result<S, D::Error> {
    let given = Value::deserialize(deserializer)?;
    let defaults = serde_json::to_value(defaults).map_err(serde::de::Error::custom)?;
    serde_json::from_value(merge(defaults, given)).map_err(serde::de::Error::custom)
}

/// Merges `over` into `base`: tables merge, other values replace.
pub(crate) fn merge(base: Value, over: Value) -> Value {
    match (base, over) {
        (Value::Object(mut base), Value::Object(over)) => {
            for (key, value) in over {
                let merged = merge(base.remove(&key).unwrap_or(Value::Null), value);
                base.insert(key, merged);
            }
            Value::Object(base)
        }
        (_, over) => over,
    }
}
