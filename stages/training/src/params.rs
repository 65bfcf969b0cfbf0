//! What a recipe may say about training.
//!
//! The tables that every method understands are [`Shared`]; each method fills them with its own defaults, and what only
//! one method understands is a table of that method's name. Only the chosen method's table is kept, so that a change
//! of another method's settings never retrains this one.

use std::collections::BTreeMap;

use engine::ParamProblem;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use crate::effects::Effects;
use crate::methods;
use crate::schedule::{LogLinear, MOST_RATE, is_rate};

/// The method that is trained where a recipe names none.
const DEFAULT_METHOD: &str = "static3dgs";

/// The parameters of one training.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingParams {
    /// The method's name (see [`methods::registry`]).
    pub method: String,
    /// What every method understands.
    pub shared: Shared,
    /// The method's own table, checked and with its defaults filled in.
    pub settings: Value,
}

/// The tables that every method understands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shared {
    /// The seed of every random choice.
    pub seed: u64,
    /// Stretches every schedule (iterations, learning rates, density control, harmonics) by this factor.
    pub schedule_scale: f64,
    /// Seconds that the training may take: `schedule_scale` then follows from what steps are found to take (see
    /// [`crate::budget`]), and the result is not reproducible bit for bit. Unset: no such limit.
    pub budget_secs: Option<f64>,
    /// Optimiser steps per phase, before stretching.
    pub iterations: BTreeMap<String, u64>,
    /// The phase after which the training ends, for others to go on from; unset: the last one.
    pub stop_after: Option<String>,
    /// Views per optimiser step.
    pub batch: usize,
    /// What is simulated beyond a static scene.
    pub effects: Effects,
    /// Where the first Gaussians are.
    pub initial_points: InitialPoints,
    /// Spherical harmonics.
    pub harmonics: Harmonics,
    /// The photometric loss.
    pub loss: Loss,
    /// Step sizes of the Gaussians' attributes.
    pub learning_rates: LearningRates,
    /// Adaptive density control.
    pub density: Density,
    /// The quality curve.
    pub curve: Curve,
}

/// Where the first Gaussians are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InitialPoints {
    /// Which points.
    pub from: PointSource,
    /// How many, where they are drawn at random.
    pub random_count: usize,
    /// At most so many of the capture's points are used, evenly chosen.
    pub max_count: usize,
}

/// Which points the first Gaussians stand on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointSource {
    /// The capture's points where it has any, else random ones.
    Auto,
    /// The capture's points.
    Capture,
    /// Uniform in the capture's bounds, mid-grey.
    Random,
}

/// Spherical harmonics: the degree starts at 0 and grows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Harmonics {
    /// The final degree, 0 to 3.
    pub degree: usize,
    /// Iterations between two degrees.
    pub interval: u64,
}

/// (1 − λ)·L1 + λ·(1 − SSIM).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Loss {
    /// λ; 0 leaves SSIM out altogether.
    pub lambda_dssim: f64,
}

/// Step sizes of the Gaussians' attributes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Positions, as a share of the scene's extent.
    pub position: LogLinear,
    /// Constant colour.
    pub sh_dc: f64,
    /// All other harmonics.
    pub sh_rest: f64,
    /// Opacity logits.
    pub opacity: f64,
    /// Logarithmic scales.
    pub scale: f64,
    /// Quaternions.
    pub rotation: f64,
}

/// Adaptive density control (Kerbl et al. 2023, section 5.2, with the constants of its code).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Density {
    /// Mean norm of the loss's gradient by the projected mean, in normalised device coordinates (pixels are multiplied
    /// by half the image size), above which a Gaussian is cloned or split.
    pub gradient_threshold: f64,
    /// Iterations between two rounds of cloning and splitting.
    pub interval: u64,
    /// No round up to this iteration.
    pub from: u64,
    /// No round from this iteration on.
    pub until: u64,
    /// Gaussians larger than this share of the extent are split, smaller ones cloned.
    pub split_above: f64,
    /// Iterations between two rounds of pruning.
    pub prune_interval: u64,
    /// Nothing is pruned up to this many Gaussians.
    pub prune_above_count: usize,
    /// Gaussians less opaque than this are pruned.
    pub min_opacity: f64,
    /// Gaussians that were seen with a larger radius are pruned, once opacities have been reset; pixels.
    pub max_radius_px: f64,
    /// Gaussians larger than this share of the extent are pruned, once opacities have been reset.
    pub max_scale: f64,
    /// Iterations between two resets of the opacity; 0 for none.
    pub opacity_reset_interval: u64,
    /// Opacity after a reset, at most.
    pub opacity_reset_to: f64,
    /// No round makes more Gaussians than this: the largest gradients go first.
    pub max_count: usize,
}

/// When the quality on a few validation views is measured; the training clock stands still meanwhile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Curve {
    /// Points on the curve, denser at the start (quadratic in the iteration); 0 for no curve.
    pub points: u64,
    /// Validation views, evenly chosen.
    pub views: usize,
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
            initial_points: InitialPoints::default(),
            harmonics: Harmonics::default(),
            loss: Loss::default(),
            learning_rates: LearningRates::default(),
            density: Density::default(),
            curve: Curve::default(),
        }
    }
}

impl Default for InitialPoints {
    fn default() -> Self {
        Self { from: PointSource::Auto, random_count: 100_000, max_count: 200_000 }
    }
}

impl Default for Harmonics {
    fn default() -> Self {
        Self { degree: 3, interval: 1000 }
    }
}

impl Default for Loss {
    fn default() -> Self {
        Self { lambda_dssim: 0.2 }
    }
}

impl Default for LearningRates {
    fn default() -> Self {
        Self {
            position: LogLinear { start: 1.6e-4, end: 1.6e-6, steps: 30_000 },
            sh_dc: 2.5e-3,
            sh_rest: 1.25e-4,
            opacity: 0.05,
            scale: 5e-3,
            rotation: 1e-3,
        }
    }
}

impl Default for Density {
    fn default() -> Self {
        Self {
            gradient_threshold: 2e-4,
            interval: 100,
            from: 500,
            until: 15_000,
            split_above: 0.01,
            prune_interval: 100,
            prune_above_count: 0,
            min_opacity: 0.005,
            max_radius_px: 20.0,
            max_scale: 0.1,
            opacity_reset_interval: 3000,
            opacity_reset_to: 0.01,
            max_count: 1_000_000,
        }
    }
}

impl Default for Curve {
    fn default() -> Self {
        Self { points: 40, views: 5 }
    }
}

impl Default for TrainingParams {
    fn default() -> Self {
        Self::of(DEFAULT_METHOD).expect("the default method is registered")
    }
}

impl TrainingParams {
    /// A method's defaults; the error names the registered methods.
    pub fn of(method: &str) -> Result<Self, String> {
        let registration = methods::find(method)?;
        let settings =
            (registration.canonical_settings)(Value::Object(Map::new())).map_err(|error| error.to_string())?;
        Ok(Self { method: method.into(), shared: (registration.shared_defaults)(), settings })
    }

    /// A method's defaults with the values of `table` laid over them, table by table.
    pub fn from_table(mut table: Map<String, Value>) -> Result<Self, String> {
        let method = match table.remove("method") {
            None => DEFAULT_METHOD.to_string(),
            Some(Value::String(method)) => method,
            Some(other) => return Err(format!("method must be a string, not {other}")),
        };
        let registration = methods::find(&method)?;
        let mut settings = Value::Object(Map::new());
        for other in methods::registry() {
            // Another method's table is checked, so that a typing error shows, and left out of this training.
            let Some(given) = table.remove(other.name) else { continue };
            let canonical =
                (other.canonical_settings)(given).map_err(|error| format!("{error} in the table {}", other.name))?;
            if other.name == method {
                settings = canonical;
            }
        }
        let defaults = serde_json::to_value((registration.shared_defaults)()).map_err(|error| error.to_string())?;
        let merged = merge(defaults, Value::Object(table));
        let shared = serde_json::from_value(merged).map_err(|error| error.to_string())?;
        let settings = (registration.canonical_settings)(settings).map_err(|error| error.to_string())?;
        Ok(Self { method, shared, settings })
    }

    /// Problems that types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let shared = &self.shared;
        let defaults = (methods::find(&self.method).expect("checked when read").shared_defaults)();
        let phases = defaults.iterations;
        let unknown_phase = shared.iterations.keys().find(|phase| !phases.contains_key(*phase));
        let known = phases.keys().cloned().collect::<Vec<_>>().join(", ");
        let Shared { initial_points, harmonics, loss, learning_rates, density, curve, .. } = shared;
        let planned = shared.iterations.values().fold(0.0, |sum, &steps| sum + steps as f64);
        let steps = planned * shared.schedule_scale;
        let is_a_rate = format!("must be in (0, {MOST_RATE}]");
        let position = learning_rates.position;
        let checks = [
            (unknown_phase.is_none(), "iterations", format!("{} has the phases {known}", self.method)),
            (
                shared.stop_after.as_ref().is_none_or(|phase| phases.contains_key(phase)),
                "stop_after",
                format!("{} has the phases {known}", self.method),
            ),
            (shared.iterations.values().any(|&n| n > 0), "iterations", "nothing to train for".into()),
            (positive(shared.schedule_scale), "schedule_scale", "must be positive".into()),
            (
                shared.budget_secs.is_none_or(|secs| secs >= LEAST_BUDGET_SECS && secs.is_finite()),
                "budget_secs",
                format!("must be at least {LEAST_BUDGET_SECS} s"),
            ),
            (
                !positive(shared.schedule_scale) || !positive(planned) || steps >= 1.0,
                "schedule_scale",
                format!("{steps:.1e} iterations are less than one"),
            ),
            (!(steps > MOST_STEPS), "schedule_scale", format!("{steps:e} iterations are more than {MOST_STEPS:e}")),
            (within(shared.batch, MOST_VIEWS), "batch", format!("must be 1 to {MOST_VIEWS}")),
            (harmonics.degree <= 3, "harmonics.degree", "must be 0 to 3".into()),
            (
                harmonics.degree == 0 || defaults.harmonics.degree > 0,
                "harmonics.degree",
                format!("must be 0: the colours of {} are no harmonics", self.method),
            ),
            (harmonics.interval > 0, "harmonics.interval", "must be at least 1".into()),
            (within(initial_points.random_count, MOST_GAUSSIANS), "initial_points.random_count", few_gaussians()),
            (within(initial_points.max_count, MOST_GAUSSIANS), "initial_points.max_count", few_gaussians()),
            ((0.0..=1.0).contains(&loss.lambda_dssim), "loss.lambda_dssim", "must be in [0, 1]".into()),
            (
                position.is_valid() && is_rate(position.start.max(position.end)),
                "learning_rates.position",
                is_a_rate.clone(),
            ),
            (is_rate(learning_rates.sh_dc), "learning_rates.sh_dc", is_a_rate.clone()),
            (is_rate(learning_rates.sh_rest), "learning_rates.sh_rest", is_a_rate.clone()),
            (is_rate(learning_rates.opacity), "learning_rates.opacity", is_a_rate.clone()),
            (is_rate(learning_rates.scale), "learning_rates.scale", is_a_rate.clone()),
            (is_rate(learning_rates.rotation), "learning_rates.rotation", is_a_rate),
            (density.interval > 0, "density.interval", "must be at least 1".into()),
            (density.prune_interval > 0, "density.prune_interval", "must be at least 1".into()),
            (positive(density.gradient_threshold), "density.gradient_threshold", "must be positive".into()),
            (positive(density.split_above), "density.split_above", "must be positive".into()),
            (positive(density.max_radius_px), "density.max_radius_px", "must be positive".into()),
            (positive(density.max_scale), "density.max_scale", "must be positive".into()),
            (within(density.max_count, MOST_GAUSSIANS), "density.max_count", few_gaussians()),
            (open_share(density.min_opacity), "density.min_opacity", "must be in (0, 1)".into()),
            (open_share(density.opacity_reset_to), "density.opacity_reset_to", "must be in (0, 1)".into()),
            (curve.points <= MOST_POINTS, "curve.points", format!("must be at most {MOST_POINTS}")),
            (curve.points == 0 || curve.views > 0, "curve.views", "must be at least 1".into()),
        ];
        let problem = |(_, key, message): (bool, &str, String)| ParamProblem { key: key.into(), message, hint: None };
        let effects = methods::find(&self.method).expect("checked when read").effects();
        let values = checks.into_iter().filter(|(good, ..)| !good).map(problem);
        values.chain(shared.effects.problems(&effects)).collect()
    }
}

/// More optimiser steps than any schedule has: beyond it, a factor was mistyped.
const MOST_STEPS: f64 = 1e8;

/// Every point of a curve renders several views: more points than this take longer than what they measure.
const MOST_POINTS: u64 = 1000;

/// What the miniature takes from which the price of a step is learnt.
const LEAST_BUDGET_SECS: f64 = 0.1;

/// More views per step than any published batch (24) by far.
const MOST_VIEWS: usize = 1024;

/// More Gaussians than memory holds: with their moments 50 million take 35 GB.
const MOST_GAUSSIANS: usize = 50_000_000;

fn few_gaussians() -> String {
    format!("must be 1 to {MOST_GAUSSIANS}")
}

fn within(count: usize, most: usize) -> bool {
    (1..=most).contains(&count)
}

fn positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

fn open_share(value: f64) -> bool {
    value > 0.0 && value < 1.0
}

/// Reads a table whose missing keys have these defaults instead of its type's.
pub(crate) fn over_defaults<'de, S: Serialize + DeserializeOwned, D: Deserializer<'de>>(
    defaults: &S,
    deserializer: D,
) -> Result<S, D::Error> {
    let given = Value::deserialize(deserializer)?;
    let defaults = serde_json::to_value(defaults).map_err(serde::de::Error::custom)?;
    serde_json::from_value(merge(defaults, given)).map_err(serde::de::Error::custom)
}

/// `base` with every value of `over` laid over it; tables merge, everything else replaces.
fn merge(base: Value, over: Value) -> Value {
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

impl Serialize for TrainingParams {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut table = match serde_json::to_value(&self.shared).map_err(serde::ser::Error::custom)? {
            Value::Object(table) => table,
            other => return Err(serde::ser::Error::custom(format!("parameters are not a table: {other}"))),
        };
        table.insert("method".into(), Value::String(self.method.clone()));
        table.insert(self.method.clone(), self.settings.clone());
        table.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for TrainingParams {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_table(Map::deserialize(deserializer)?).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(value: Value) -> Result<TrainingParams, serde_json::Error> {
        serde_json::from_value(value)
    }

    #[test]
    fn canonical_parameters_read_back_equal_for_every_method() {
        for registration in methods::registry() {
            let params = TrainingParams::of(registration.name).unwrap();
            assert!(params.problems().is_empty(), "{}: {:?}", registration.name, params.problems());
            assert_eq!(read(serde_json::to_value(&params).unwrap()).unwrap(), params);
            assert_eq!(read(json!({ "method": registration.name })).unwrap(), params);
        }
    }

    #[test]
    fn partial_tables_keep_the_methods_own_defaults() {
        let params = read(json!({ "method": "deformable4dgs", "density": { "until": 5000 } })).unwrap();
        let defaults = TrainingParams::of("deformable4dgs").unwrap();
        assert_eq!(params.shared.density.until, 5000);
        assert_eq!(params.shared.density.prune_interval, defaults.shared.density.prune_interval);
        assert_ne!(params.shared.density.prune_interval, Density::default().prune_interval);
    }

    #[test]
    fn another_methods_table_is_checked_and_left_out() {
        let plain = read(json!({ "method": "static3dgs" })).unwrap();
        let with_other = json!({ "method": "static3dgs", "deformable4dgs": { "time_resolution": 75 } });
        assert_eq!(read(with_other).unwrap(), plain);
        let misspelt = json!({ "method": "static3dgs", "deformable4dgs": { "time_rezolution": 75 } });
        assert!(read(misspelt).unwrap_err().to_string().contains("time_rezolution"));
    }

    #[test]
    fn unknown_keys_methods_and_phases_are_refused() {
        for bad in [json!({ "sed": 1 }), json!({ "density": { "intervall": 1 } }), json!({ "method": "nerf" })] {
            assert!(read(bad.clone()).is_err(), "{bad} was accepted");
        }
        let params = read(json!({ "iterations": { "fine": 5 } })).unwrap();
        assert!(params.problems().iter().any(|problem| problem.key == "iterations"));
    }

    #[test]
    fn values_that_cannot_work_are_refused_by_key() {
        let bad = [
            ("schedule_scale", json!({ "schedule_scale": -1.0 })),
            ("schedule_scale", json!({ "schedule_scale": 1e300 })),
            ("schedule_scale", json!({ "schedule_scale": 1e-300 })),
            ("budget_secs", json!({ "budget_secs": 1e-9 })),
            ("curve.points", json!({ "curve": { "points": 1_000_000_000_u64 } })),
            ("learning_rates.position", json!({ "learning_rates": { "position": { "start": 1e30 } } })),
            ("learning_rates.opacity", json!({ "learning_rates": { "opacity": 11.0 } })),
            ("batch", json!({ "batch": 1_000_000 })),
            ("initial_points.random_count", json!({ "initial_points": { "random_count": u64::MAX } })),
            ("learning_rates.opacity", json!({ "learning_rates": { "opacity": -1.0 } })),
            ("density.max_scale", json!({ "density": { "max_scale": -1.0 } })),
            ("harmonics.degree", json!({ "method": "modecgs", "harmonics": { "degree": 1 } })),
            ("density.split_above", json!({ "density": { "split_above": -3.0 } })),
        ];
        for (key, table) in bad {
            let problems = read(table).unwrap().problems();
            assert_eq!(problems.iter().map(|problem| problem.key.as_str()).collect::<Vec<_>>(), [key]);
        }
    }
}
