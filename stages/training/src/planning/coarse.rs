//! One coarse phase for several trainings: methods with the same first phase continue from one model.
//!
//! A training with `stop_after` saves the model at the end of a phase. Another training with exactly the same phase
//! takes that model on the port `start` and ends in the same bytes as a training that runs all phases itself.

#[cfg(test)]
mod tests;

use engine::{Failure, FailureKind};
use serde_json::{Value, json};

use crate::artifact::Model;
use crate::data::Dataset;
use crate::method::CoarseSharing;
use crate::methods;
use crate::params::TrainingParams;

/// Everything that the shared phase of a training depends on besides its capture; `None` without such a phase. Phases
/// with equal values are equal, step by step.
pub(crate) fn recipe(params: &TrainingParams) -> Option<Value> {
    let registration = methods::find(&params.method).ok()?;
    let CoarseSharing { base, phase, settings } = registration.coarse(&params.shared, &params.settings).ok()??;
    // Exhaustive, so that a new table does not compile until it is decided whether this phase reads it.
    let crate::shared::Shared {
        seed,
        schedule_scale,
        budget_secs,
        iterations,
        stop_after: _,
        batch,
        effects: _,
        without,
        initial_points,
        seeds: _,
        harmonics,
        loss,
        learning_rates,
        density,
        curve: _,
    } = &params.shared;
    if budget_secs.is_some() || params.shared.has_seeds() {
        // The length of the phase is unknown until the training has begun, or the phase depends on masks.
        return None;
    }
    Some(json!({
        "base": base, "phase": phase, "settings": settings, "seed": seed, "schedule_scale": schedule_scale,
        "iterations": iterations.get(phase), "batch": batch, "initial_points": initial_points, "harmonics": harmonics,
        "loss": loss, "learning_rates": learning_rates, "density": density, "without": without,
    }))
}

/// The recipe of the shared phase, for a training that stops at its end.
pub(crate) fn offered(params: &TrainingParams) -> Option<Value> {
    let recipe = recipe(params)?;
    (params.shared.stop_after.as_deref() == recipe["phase"].as_str()).then_some(recipe)
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
    let ours = recipe(params).ok_or_else(|| {
        refuse(format!("{} shares no phase, so it cannot continue from a model", params.method)) //
    })?;
    let theirs: TrainingParams = serde_json::from_value(start.header.method_params.clone())?;
    let theirs = offered(&theirs)
        .ok_or_else(|| refuse("the model on `start` was not saved at the end of a shared phase".into()))?;
    let differences = differences(&theirs, &ours);
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
