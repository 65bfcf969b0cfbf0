//! One coarse phase for several trainings: methods that begin alike go on from one model instead of training it again.
//!
//! A training with `stop_after` saves the model where a phase ends. Another one that would have done the very same up to
//! there takes that model on the port `start` and ends in the same bytes as if it had done everything itself.

#[cfg(test)]
mod tests;

use engine::{Failure, FailureKind};
use serde_json::{Value, json};

use crate::artifact::Model;
use crate::dataset::Dataset;
use crate::methods;
use crate::params::TrainingParams;

/// What a method's first phase does, so far as the tables that every method understands do not say it.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseSharing {
    /// The base whose phase it is, as `hexplane`: phases of different bases are never alike.
    pub base: &'static str,
    /// The first phase.
    pub phase: &'static str,
    /// The method's own settings that the phase depends on.
    pub settings: Value,
}

/// Everything that the shared phase of a training depends on besides its capture; none if it has no such phase. Equal
/// values are equal phases, step by step.
pub fn recipe(params: &TrainingParams) -> Option<Value> {
    let registration = methods::find(&params.method).ok()?;
    let CoarseSharing { base, phase, settings } = registration.coarse(params).ok()??;
    // Named one by one, so that whoever adds a table decides whether this phase reads it.
    let crate::params::Shared {
        seed,
        schedule_scale,
        budget_secs,
        iterations,
        stop_after: _,
        batch,
        effects: _,
        initial_points,
        harmonics,
        loss,
        learning_rates,
        density,
        curve: _,
    } = &params.shared;
    if budget_secs.is_some() {
        // How long the phase will be is not known before the training has begun.
        return None;
    }
    Some(json!({
        "base": base, "phase": phase, "settings": settings, "seed": seed, "schedule_scale": schedule_scale,
        "iterations": iterations.get(phase), "batch": batch, "initial_points": initial_points, "harmonics": harmonics,
        "loss": loss, "learning_rates": learning_rates, "density": density,
    }))
}

/// What a training leaves behind for others: its recipe, if it stops where the shared phase ends.
pub fn offered(params: &TrainingParams) -> Option<Value> {
    let recipe = recipe(params)?;
    (params.shared.stop_after.as_deref() == recipe["phase"].as_str()).then_some(recipe)
}

/// The dotted keys in which two recipes differ, each as `density.max_count 360000 → 200000`; empty if they are equal.
pub fn differences(theirs: &Value, ours: &Value) -> Vec<String> {
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

/// Refuses a model that is not what this training would have made up to there, on this data.
pub fn check_start(start: &Model, params: &TrainingParams, dataset: &Dataset) -> anyhow::Result<()> {
    let refuse = |message: String| {
        let hint = "train it with the same parameters and stop_after, or leave the port `start` unwired";
        anyhow::Error::from(Failure::new(FailureKind::BadInput, message).hint(hint))
    };
    let ours = recipe(params).ok_or_else(|| {
        refuse(format!("{} has no phase that it shares, so that it cannot go on from a model", params.method)) //
    })?;
    let theirs: TrainingParams = serde_json::from_value(start.header.method_params.clone())?;
    let theirs = offered(&theirs)
        .ok_or_else(|| refuse("the model on `start` was trained to its end, not up to a shared phase".into()))?;
    let differences = differences(&theirs, &ours);
    if !differences.is_empty() {
        let message = format!("the model on `start` is not what this training begins with: {}", differences.join(", "));
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
