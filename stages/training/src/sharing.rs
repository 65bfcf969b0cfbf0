//! First phases of several trainings that are trained once: all of them continue from one model.
//!
//! A training with `stop_after` saves the model at the end of a phase. Another training with exactly the same phases up
//! to there takes that model on the port `start` and ends in the same bytes as a training that runs all phases itself.

#[cfg(test)]
mod tests;

use engine::{Failure, FailureKind};
use serde_json::{Value, json};

use crate::artifact::Model;
use crate::data::Dataset;
use crate::effects::NOTHING_LEFT_OUT;
use crate::method::SharedPhase;
use crate::params::TrainingParams;
use crate::shared::Shared;

/// Everything that a training depends on up to the end of one of its shared phases, besides its capture. Trainings with
/// equal values are equal up to there, step by step.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shareable {
    /// The phase.
    pub phase: SharedPhase,
    /// The values, by name.
    pub recipe: Value,
}

/// The shared phases of a training, in their order.
pub(crate) fn shareable(params: &TrainingParams) -> Vec<Shareable> {
    let Shared { budget_secs, .. } = &params.shared;
    if budget_secs.is_some() || params.shared.has_seeds() || params.shared.resolution_schedule().is_some() {
        // The length of the phases is unknown until the training has begun, or they depend on masks or on the length of
        // later phases.
        return Vec::new();
    }
    let phases = params.registration().shared_phases(&params.shared, &params.settings).unwrap_or_default();
    phases.into_iter().map(|phase| Shareable { recipe: recipe(params, &phase), phase }).collect()
}

fn recipe(params: &TrainingParams, of: &SharedPhase) -> Value {
    let SharedPhase { base, phase, settings, iterations, effects: read, losses } = of;
    // Exhaustive, so that a new table does not compile until it is decided whether these phases read it.
    let Shared {
        seed,
        schedule_scale,
        budget_secs: _,
        iterations: _,
        stop_after: _,
        batch,
        effects,
        without,
        initial_points,
        seeds: _,
        harmonics,
        loss,
        learning_rates,
        density,
        coarse_to_fine: _,
        temporal_pruning: _,
        view_consistency: _,
        curve: _,
    } = &params.shared;
    let without = if losses.contains(&without.as_str()) { without } else { NOTHING_LEFT_OUT };
    let effects: Vec<&&str> = read.iter().filter(|name| effects.has(name)).collect();
    json!({
        "base": base, "phase": phase, "settings": settings, "seed": seed, "schedule_scale": schedule_scale,
        "iterations": iterations, "batch": batch, "effects": effects, "initial_points": initial_points,
        "harmonics": harmonics, "loss": loss, "learning_rates": learning_rates, "density": density, "without": without,
    })
}

/// The shared phase at whose end a training stops, whether or not another training may continue from it.
pub(crate) fn last_phase(params: &TrainingParams) -> Option<SharedPhase> {
    let last = params.shared.stop_after.as_deref()?;
    let phases = params.registration().shared_phases(&params.shared, &params.settings).unwrap_or_default();
    phases.into_iter().find(|phase| phase.phase == last)
}

/// The shared phase at whose end a training stops, for others that continue from it.
pub(crate) fn offered(params: &TrainingParams) -> Option<Shareable> {
    let last = params.shared.stop_after.as_deref()?;
    shareable(params).into_iter().find(|shared| shared.phase.phase == last)
}

/// The differences of two recipes, e.g. `density.max_count 360000 → 200000`; empty if they are equal.
pub(crate) fn differences(theirs: &Value, ours: &Value) -> Vec<String> {
    let mut found = Vec::new();
    add_differences("", theirs, ours, &mut found);
    found
}

fn add_differences(key: &str, theirs: &Value, ours: &Value, found: &mut Vec<String>) {
    match (theirs, ours) {
        (Value::Object(left), Value::Object(right)) => {
            let names: std::collections::BTreeSet<&String> = left.keys().chain(right.keys()).collect();
            for name in names {
                let key = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
                let value = |map: &serde_json::Map<String, Value>| map.get(name).cloned().unwrap_or(Value::Null);
                add_differences(&key, &value(left), &value(right), found);
            }
        }
        _ if theirs != ours => found.push(format!("{key} {theirs} → {ours}")),
        _ => (),
    }
}

/// Refuses a start that is not exactly the model that this training would have on this data after the shared phase.
pub(crate) fn check_start(start: &Model, params: &TrainingParams, dataset: &Dataset) -> anyhow::Result<()> {
    let refuse = |message: String| {
        let hint = "train it with the same parameters and stop_after, or leave the port `start` unwired";
        anyhow::Error::from(Failure::new(FailureKind::BadInput, message).hint(hint))
    };
    let ours = shareable(params);
    if ours.is_empty() {
        return Err(refuse(format!("{} shares no phase, so it cannot continue from a model", params.method)));
    }
    let theirs: TrainingParams = serde_json::from_value(start.header.method_params.clone())?;
    let theirs = offered(&theirs)
        .ok_or_else(|| refuse("the model on `start` was not saved at the end of a shared phase".into()))?;
    let name = theirs.phase.phase;
    let ours = ours.into_iter().find(|shared| shared.phase.phase == name).ok_or_else(|| {
        refuse(format!("{} has no phase `{name}` with these effects, where the model on `start` ends", params.method))
    })?;
    let differences = differences(&theirs.recipe, &ours.recipe);
    if !differences.is_empty() {
        let message = format!(
            "the model on `start` has other parameters than this training begins with: {}",
            differences.join(", ")
        );
        return Err(refuse(message));
    }
    let (header, capture, scene) = (&start.header, &dataset.capture, &dataset.scene);
    let same_data = header.protocol == capture.protocol
        && header.background == capture.background
        && header.time_map == capture.time_map
        && header.scene_extent == scene.extent
        && header.time_count == scene.time_count;
    if same_data { Ok(()) } else { Err(refuse("the model on `start` was trained on another capture".into())) }
}
