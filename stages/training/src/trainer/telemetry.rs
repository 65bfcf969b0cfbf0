//! Measurements of a running training. No step depends on them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shaders::tape::{Cost, Profile};

use super::curve::CurvePoint;
use crate::artifact::LargestGradient;
use crate::artifact::PhaseInfluence;
use crate::method::SkippedWork;

/// The measurements of a running training.
#[derive(Clone, Default)]
pub(super) struct Telemetry {
    /// The part that a resumed training continues.
    pub history: History,
    /// Seconds and calls per operation since the last resumption.
    pub profile: Profile,
    /// Seconds of the backward passes of single losses in sampled steps on the CPU, since the last resumption.
    pub backward: BTreeMap<&'static str, Cost>,
    /// The total loss of every step.
    #[cfg(test)]
    pub losses: Vec<f64>,
}

/// The measurements that a checkpoint stores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct History {
    /// Quality over seconds.
    pub curve: Vec<CurvePoint>,
    /// The total loss of the last step; NaN before the first one.
    pub loss: f64,
    /// Weighted loss values summed over steps, by loss.
    pub loss_sums: BTreeMap<String, f64>,
    /// The influence of losses by phase.
    pub influence: BTreeMap<String, PhaseInfluence>,
    /// The slot of the running phase in which each loss was last sampled.
    pub sampled_slots: BTreeMap<String, u64>,
    /// Work left out, by name: the amount left out and the total amount.
    pub skipped: BTreeMap<String, [u64; 2]>,
    /// The largest gradient of every tensor.
    pub largest_gradients: BTreeMap<String, LargestGradient>,
    /// Number of values that the rasteriser clamped, by guard.
    pub guards: BTreeMap<String, u64>,
    /// What step hooks report, e.g. that pruning would have emptied the model.
    pub notices: Vec<String>,
}

impl Default for History {
    fn default() -> Self {
        Self {
            curve: Vec::new(),
            loss: f64::NAN,
            loss_sums: BTreeMap::new(),
            influence: BTreeMap::new(),
            sampled_slots: BTreeMap::new(),
            skipped: BTreeMap::new(),
            largest_gradients: BTreeMap::new(),
            guards: BTreeMap::new(),
            notices: Vec::new(),
        }
    }
}

impl Telemetry {
    /// Adds the weighted losses of one step.
    pub(crate) fn record_losses(&mut self, phase: &str, losses: &BTreeMap<&'static str, f64>) {
        self.history.loss = losses.values().sum();
        self.influence_mut(phase).count(losses.keys().copied());
        #[cfg(test)]
        self.losses.push(self.history.loss);
        for (&name, value) in losses {
            match self.history.loss_sums.get_mut(name) {
                Some(sum) => *sum += value,
                None => drop(self.history.loss_sums.insert(name.into(), *value)),
            }
        }
    }

    /// Adds the cost of one step and the work that it left out.
    pub(crate) fn record_work(&mut self, profile: &Profile, skipped: &SkippedWork) {
        self.profile.merge(profile);
        self.record_events(profile.events.iter().map(|(what, count)| (*what, *count)));
        self.record_skipped(skipped);
    }

    /// Adds the work that one step left out.
    pub(crate) fn record_skipped(&mut self, skipped: &SkippedWork) {
        for (&what, [left_out, of]) in skipped {
            let total = self.history.skipped.entry(what.into()).or_default();
            *total = [total[0] + left_out, total[1] + of];
        }
    }

    /// Adds counts of values that the rasteriser clamped.
    pub(crate) fn record_events(&mut self, events: impl IntoIterator<Item = (&'static str, u64)>) {
        for (what, count) in events {
            *self.history.guards.entry(what.into()).or_default() += count;
        }
    }

    /// Adds the squared gradient norms of a sampled step, by loss and tensor.
    pub(crate) fn record_influence(
        &mut self,
        phase: &str,
        iteration: u64,
        squared_by_loss: &BTreeMap<&'static str, Vec<(&str, f64)>>,
    ) {
        for (loss, norms) in squared_by_loss {
            self.influence_mut(phase).add_sample(loss, iteration, norms.iter().copied());
        }
    }

    /// Records the known units of losses in a phase.
    pub(crate) fn record_units<'n>(&mut self, phase: &str, units: impl Iterator<Item = (&'n str, f64)>) {
        self.influence_mut(phase).record_units(units);
    }

    /// The influence of losses in a phase so far.
    fn influence_mut(&mut self, phase: &str) -> &mut PhaseInfluence {
        let influence = &mut self.history.influence;
        if !influence.contains_key(phase) {
            influence.insert(phase.into(), PhaseInfluence::default());
        }
        influence.get_mut(phase).expect("just inserted")
    }

    /// Keeps the largest magnitude of each gradient, with the step at which it occurred.
    pub(crate) fn record_gradients<'n>(
        &mut self,
        phase: &str,
        iteration: u64,
        magnitudes: impl IntoIterator<Item = (&'n str, f32)>,
    ) {
        for (name, magnitude) in magnitudes {
            let magnitude = f64::from(magnitude);
            let largest_gradients = &mut self.history.largest_gradients;
            if largest_gradients.get(name).is_none_or(|known| magnitude > known.magnitude) {
                let largest = LargestGradient { magnitude, phase: phase.into(), iteration };
                largest_gradients.insert(name.into(), largest);
            }
        }
    }
}
