//! The parameters of one training, as a recipe gives them.
//!
//! The tables that every method understands are [`Shared`]; each method has its own defaults for them. The settings of
//! a single method are a table with the name of the method. Only the chosen method's table is kept, so a change of
//! another method's settings never retrains this one.

use anyhow::Context as _;
use engine::ParamProblem;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use crate::check::Checks;
use crate::method::Method;
use crate::methods::{self, Registration, UnknownName};
use crate::schedule::Phase;
use crate::shared::{Shared, merge};

/// The method of recipes that do not name one.
const DEFAULT_METHOD: &str = "static3dgs";

/// The parameters of one training.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingParams {
    /// The method's name.
    pub(crate) method: String,
    /// The tables that every method understands.
    pub(crate) shared: Shared,
    /// The method's own table with its defaults filled in.
    pub(crate) settings: Value,
    /// The problems in the tables of this and other methods.
    pub(crate) table_problems: Vec<ParamProblem>,
}

/// The reason why a table is not valid as the parameters of a training.
#[derive(Debug, thiserror::Error)]
pub(crate) enum InvalidTable {
    /// The method is not registered.
    #[error(transparent)]
    UnknownMethod(#[from] UnknownName),
    /// A value has a wrong type or an unknown key.
    #[error("{0}")]
    Value(String),
}

impl Default for TrainingParams {
    fn default() -> Self {
        Self::of(DEFAULT_METHOD).expect("the default method is registered")
    }
}

impl TrainingParams {
    /// A method's defaults.
    pub(crate) fn of(method: &str) -> Result<Self, UnknownName> {
        let registration = methods::find(method)?;
        let settings = (registration.canonical_settings)(&Value::Object(Map::new()));
        let (settings, found) = settings.expect("the default settings of a method are valid");
        let shared = (registration.shared_defaults)();
        Ok(Self { method: method.into(), shared, settings, table_problems: found.problems })
    }

    /// The method, configured by these parameters.
    pub(crate) fn build(&self) -> anyhow::Result<Box<dyn Method<f32>>> {
        self.registration().build_f32(&self.shared, &self.settings)
    }

    /// The phases of a method that a job runs: all of them, or those up to `stop_after`.
    pub(crate) fn phases_to_run(&self, method: &dyn Method<f32>) -> anyhow::Result<Vec<Phase>> {
        let mut phases = method.phases();
        if let Some(last) = &self.shared.stop_after {
            let at = phases.iter().position(|phase| phase.name == last);
            phases.truncate(at.with_context(|| format!("{} has no phase {last}", self.method))? + 1);
        }
        Ok(phases)
    }

    /// A method's defaults with the values of `table` merged in, table by table.
    pub(crate) fn from_table(mut table: Map<String, Value>) -> Result<Self, InvalidTable> {
        let invalid = |error: serde_json::Error| InvalidTable::Value(error.to_string());
        let method = match table.remove("method") {
            None => DEFAULT_METHOD.to_string(),
            Some(Value::String(method)) => method,
            Some(other) => return Err(InvalidTable::Value(format!("method must be a string, not {other}"))),
        };
        let registration = methods::find(&method)?;
        table.entry(&method).or_insert_with(|| Value::Object(Map::new()));
        let (mut settings, mut checks) = (Value::Null, Checks::default());
        for owner in methods::registry() {
            // Another method's table is checked, to report misspelt keys and wrong values, but not kept.
            let Some(given) = table.remove(owner.name) else { continue };
            let canonical = (owner.canonical_settings)(&given);
            let (canonical, found) =
                canonical.map_err(|error| InvalidTable::Value(format!("{error} in the table {}", owner.name)))?;
            checks = checks.within(owner.name, found);
            if owner.name == method {
                settings = canonical;
            }
        }
        let defaults = serde_json::to_value((registration.shared_defaults)()).map_err(invalid)?;
        // A key of the method's table, given outside of it. The message has serde's form, for which the engine writes a hint.
        if let Some(key) = table.keys().find(|key| defaults.get(key).is_none() && settings.get(key).is_some()) {
            return Err(InvalidTable::Value(format!("unknown field `{key}`, expected `{method}.{key}`")));
        }
        let shared = serde_json::from_value(merge(defaults, Value::Object(table))).map_err(invalid)?;
        Ok(Self { method, shared, settings, table_problems: checks.problems })
    }

    /// The registered method of these parameters.
    pub(crate) fn registration(&self) -> &'static Registration {
        methods::find(&self.method).expect("parameters are only made for registered methods")
    }

    /// The problems that types cannot express.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let registration = self.registration();
        let values = self.shared.problems(&self.method, &(registration.shared_defaults)());
        let effects = self.shared.effects.problems(&self.method, &registration.effects());
        let tables = self.table_problems.iter().cloned();
        values.into_iter().chain(tables).chain(effects).chain(self.unknown_part()).chain(self.unknown_phase()).collect()
    }

    /// The problem of a `stop_after` that is not a phase of the method.
    fn unknown_phase(&self) -> Option<ParamProblem> {
        let last = self.shared.stop_after.as_deref()?;
        let own = self.registration().shared_phases(&self.shared, &self.settings).unwrap_or_default();
        let mut known: Vec<&str> = self.shared.iterations.keys().map(String::as_str).collect();
        known
            .extend(own.iter().map(|shared| shared.phase).filter(|phase| !self.shared.iterations.contains_key(*phase)));
        let message = format!("{} has the phases {}", self.method, known.join(", "));
        (!known.contains(&last)).then(|| ParamProblem { key: "stop_after".into(), message, hint: None })
    }

    /// The problem of a `without` that no method has. A part of another method is not a problem: an axis has all of them.
    fn unknown_part(&self) -> Option<ParamProblem> {
        let (without, parts) = (&self.shared.without, methods::parts());
        let message = format!("no method has an effect or a loss `{without}`");
        let hint = Some(format!("one of: {}", parts.join(", ")));
        (!parts.contains(without)).then(|| ParamProblem { key: "without".into(), message, hint })
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
        Self::from_table(Map::deserialize(deserializer)?).map_err(|error| match error {
            InvalidTable::UnknownMethod(UnknownName { got, known }) => serde::de::Error::unknown_variant(&got, known),
            InvalidTable::Value(message) => serde::de::Error::custom(message),
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::shared::Density;

    fn read(value: Value) -> Result<TrainingParams, serde_json::Error> {
        serde_json::from_value(value)
    }

    fn keys(problems: &[ParamProblem]) -> Vec<&str> {
        problems.iter().map(|problem| problem.key.as_str()).collect()
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
    fn a_single_value_of_a_nested_table_keeps_the_rest() {
        let given = json!({ "deformation": { "gaussians": { "time_resolution": 20 } } });
        for method in ["modecgs", "kineticgs"] {
            let params = read(json!({ "method": method, method: given })).unwrap();
            let mut expected = TrainingParams::of(method).unwrap();
            expected.settings["deformation"]["gaussians"]["time_resolution"] = json!(20);
            assert_eq!(params, expected);
        }
    }

    #[test]
    fn another_methods_table_is_checked_and_dropped() {
        let plain = read(json!({ "method": "static3dgs" })).unwrap();
        let with_other = json!({ "method": "static3dgs", "deformable4dgs": { "time_resolution": 75 } });
        assert_eq!(read(with_other).unwrap(), plain);
        let wrong = json!({ "method": "static3dgs", "deformable4dgs": { "channels": 0 } });
        assert_eq!(keys(&read(wrong).unwrap().problems()), ["deformable4dgs.channels"]);
        let misspelt = json!({ "method": "static3dgs", "deformable4dgs": { "time_rezolution": 75 } });
        assert!(read(misspelt).unwrap_err().to_string().contains("time_rezolution"));
    }

    #[test]
    fn unknown_keys_methods_and_phases_are_refused() {
        for bad in [json!({ "sed": 1 }), json!({ "density": { "intervall": 1 } }), json!({ "method": "nerf" })] {
            assert!(read(bad.clone()).is_err(), "{bad} was accepted");
        }
        let beside = read(json!({ "method": "deformable4dgs", "network_rate": { "start": 0.1 } })).unwrap_err();
        assert_eq!(beside.to_string(), "unknown field `network_rate`, expected `deformable4dgs.network_rate`");
        let params = read(json!({ "iterations": { "fine": 5 } })).unwrap();
        assert!(params.problems().iter().any(|problem| problem.key == "iterations"));
    }

    #[test]
    fn invalid_values_are_reported_by_key() {
        let bad = [
            ("schedule_scale", json!({ "schedule_scale": -1.0 })),
            ("schedule_scale", json!({ "schedule_scale": 1e300 })),
            ("schedule_scale", json!({ "schedule_scale": 1e-300 })),
            ("budget_secs", json!({ "budget_secs": 1e-9 })),
            ("curve.points", json!({ "curve": { "points": 1_000_000_000_u64 } })),
            ("learning_rates.position.start", json!({ "learning_rates": { "position": { "start": 1e30 } } })),
            ("learning_rates.opacity", json!({ "learning_rates": { "opacity": 11.0 } })),
            ("batch", json!({ "batch": 1_000_000 })),
            ("initial_points.random_count", json!({ "initial_points": { "random_count": u64::MAX } })),
            ("learning_rates.opacity", json!({ "learning_rates": { "opacity": -1.0 } })),
            ("density.max_scale", json!({ "density": { "max_scale": -1.0 } })),
            ("harmonics.degree", json!({ "method": "modecgs", "harmonics": { "degree": 1 } })),
            ("without", json!({ "without": "photometric" })),
            ("density.split_above", json!({ "density": { "split_above": -3.0 } })),
            ("seeds.weight", json!({ "seeds": { "weight": 1e300 } })),
            ("scgs.nodes.rate.start", json!({ "method": "scgs", "scgs": { "nodes": { "rate": { "start": 11.0 } } } })),
            ("l4dgs.semantic_rate", json!({ "method": "l4dgs", "l4dgs": { "semantic_rate": 11.0 } })),
            (
                "l4dgs.shares.dynamic_depth",
                json!({ "method": "l4dgs", "l4dgs": { "shares": { "dynamic_depth": 1e300 } } }),
            ),
            ("mcgs.noise.position_px", json!({ "method": "mcgs", "mcgs": { "noise": { "position_px": 1e300 } } })),
            ("realtime4dgs.clip_length", json!({ "method": "realtime4dgs", "realtime4dgs": { "clip_length": 1e300 } })),
            (
                "realtime4dgs.clip_length",
                json!({ "method": "realtime4dgs", "realtime4dgs": { "clip_length": 1e-300 } }),
            ),
        ];
        for (key, table) in bad {
            assert_eq!(keys(&read(table).unwrap().problems()), [key]);
        }
    }

    #[test]
    fn every_invalid_value_of_a_methods_tables_is_reported_by_its_whole_key() {
        let tables = json!({ "nodes": { "count": 0, "rate": { "end": 0.0 } }, "chain": { "heads": 3 } });
        let params = read(json!({ "method": "mcgs", "batch": 0, "mcgs": tables })).unwrap();
        let expected = ["batch", "mcgs.nodes.count", "mcgs.nodes.rate.end", "mcgs.chain.heads"];
        assert_eq!(keys(&params.problems()), expected);
        let refusal = params.build().err().unwrap().to_string();
        assert!(expected[1..].iter().all(|key| refusal.contains(key)), "{refusal}");
    }
}
