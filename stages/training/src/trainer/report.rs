//! The measurements of a training, as its job reports them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shaders::tape::Profile;

use super::curve::CurvePoint;
use super::telemetry::Telemetry;
use super::{Trainer, UNCLOCKED};
use crate::artifact::LargestGradient;
use crate::artifact::{PhaseInfluence, Stalled};
use crate::clock::{ClockReading, of_loss};
use crate::device::GpuUse;
use crate::params::TrainingParams;
use crate::schedule::Phase;

/// The measurements of a training. Field names are the names of the measurements in the job's record.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Seconds of training, without evaluation and sampling of the influence of losses.
    pub training_secs: f64,
    /// Seconds of training, with evaluation and sampling.
    pub total_secs: f64,
    /// Training time per step, milliseconds.
    pub ms_per_iteration: f64,
    /// Training time per step by phase and activity, milliseconds.
    pub ms_per_iteration_by_phase: BTreeMap<String, BTreeMap<String, f64>>,
    /// Each loss's share of the total value, and its time.
    pub loss_shares: BTreeMap<String, LossShare>,
    /// Weighted loss values summed over steps, by loss.
    pub loss_sums: BTreeMap<String, f64>,
    /// The gradients of every loss by phase.
    pub influence: BTreeMap<String, PhaseInfluence>,
    /// The simulated effects that stay on even if they are inert, each with the reason.
    pub kept_effects: BTreeMap<&'static str, &'static str>,
    /// Seconds per activity.
    pub phases: BTreeMap<String, f64>,
    /// Seconds per phase and activity.
    pub seconds_by_phase: ClockReading,
    /// Quality over seconds.
    pub curve: Vec<CurvePoint>,
    /// The split that the curve was measured on.
    pub curve_split: scene::Split,
    /// Milliseconds per call of every kernel, forward and backward, since the last resumption.
    pub kernels_ms: BTreeMap<String, [f64; 2]>,
    /// GPU use per step since the last resumption; `None` on the CPU.
    pub gpu: Option<GpuUse>,
    /// Work left out because it could not change the result, by name: the amount left out and the total amount.
    pub skipped_work: BTreeMap<String, [u64; 2]>,
    /// Values that the parts of the method report about the model, by name.
    pub figures: BTreeMap<String, f64>,
    /// The largest gradient of every tensor.
    pub largest_gradients: BTreeMap<String, LargestGradient>,
    /// Events that a reader of the report must know, e.g. that pruning would have emptied the model.
    pub notices: Vec<String>,
    /// Number of values that the rasteriser clamped, by guard, summed over renders.
    pub guards: BTreeMap<String, u64>,
}

/// The measurements of the training whose model another training continues: a part of its [`Report`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Earlier {
    /// Seconds by phase and activity.
    #[serde(rename = "seconds_by_phase")]
    pub clock: ClockReading,
    /// Quality over seconds.
    pub curve: Vec<CurvePoint>,
    /// Weighted loss values summed over steps, by loss.
    pub loss_sums: BTreeMap<String, f64>,
    /// The gradients of every loss by phase.
    pub influence: BTreeMap<String, PhaseInfluence>,
    /// Work left out, by name: the amount left out and the total amount.
    #[serde(rename = "skipped_work")]
    pub skipped: BTreeMap<String, [u64; 2]>,
    /// The largest gradient of every tensor.
    pub largest_gradients: BTreeMap<String, LargestGradient>,
    /// Number of values that the rasteriser clamped, by guard.
    pub guards: BTreeMap<String, u64>,
    /// Events that a reader of the report must know.
    pub notices: Vec<String>,
}

/// The contribution of one loss, and its cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossShare {
    /// Share of the sum of all weighted values over all steps.
    pub value_share: f64,
    /// Seconds of its evaluation (activity `loss NAME`), from the end of the work before it. Losses that are evaluated
    /// together share the time in equal parts. Work that several losses share, e.g. renders, is charged to none.
    pub forward_secs: Option<f64>,
    /// Seconds of its backward pass if it were the only loss, estimated from the sampled steps since the last
    /// resumption; work that it shares with other losses is included. None on a GPU, where single passes are not timed.
    pub backward_secs: Option<f64>,
}

impl Trainer<'_> {
    /// The measurements so far.
    pub fn report(&mut self) -> Report {
        let clock = self.clock.reading();
        let (steps, _) = self.steps();
        let training_secs = clock.total_except(&UNCLOCKED);
        let figures = self.figures();
        let phases = &self.setup.phases[..=self.state.phase];
        let Telemetry { history, profile, .. } = &self.telemetry;
        Report {
            training_secs,
            total_secs: clock.total_except(&[]),
            ms_per_iteration: 1e3 * training_secs / steps.max(1) as f64,
            ms_per_iteration_by_phase: milliseconds_by_phase(&clock, phases, self.state.iteration),
            loss_shares: self.loss_shares(&clock),
            loss_sums: history.loss_sums.clone(),
            influence: self.influence(),
            kept_effects: kept_effects(self.setup.params),
            phases: clock.by_activity(),
            seconds_by_phase: clock,
            curve: history.curve.clone(),
            curve_split: self.setup.start.dataset.curve_split,
            kernels_ms: kernel_milliseconds(profile),
            gpu: self.meter.as_ref().map(|meter| meter.per_iteration(steps)),
            skipped_work: history.skipped.clone(),
            figures,
            largest_gradients: history.largest_gradients.clone(),
            notices: self.notices(),
            guards: history.guards.clone(),
        }
    }
}

/// The simulated effects that stay on even if they are inert, each with the reason.
fn kept_effects(params: &TrainingParams) -> BTreeMap<&'static str, &'static str> {
    let simulated = params.registration().effects().into_iter().filter(|effect| params.shared.effects.has(effect.name));
    simulated.filter_map(|effect| Some((effect.name, effect.stays?))).collect()
}

impl Trainer<'_> {
    /// Value and time shares of every loss.
    fn loss_shares(&self, clock: &ClockReading) -> BTreeMap<String, LossShare> {
        let Telemetry { history, backward, .. } = &self.telemetry;
        let total: f64 = history.loss_sums.values().map(|sum| sum.abs()).sum();
        let activities = clock.by_activity();
        let acted = |name: &String| -> u64 {
            history.influence.values().filter_map(|phase| Some(phase.losses.get(name)?.acted)).sum()
        };
        let share = |(name, sum): (&String, &f64)| {
            let forward_secs = activities.get(&of_loss(name)).copied();
            let per_step = backward.get(name.as_str()).map(|cost| cost.secs / cost.calls as f64);
            let backward_secs = per_step.map(|secs| secs * acted(name) as f64);
            let value_share = if total > 0.0 { sum.abs() / total } else { 0.0 };
            (name.clone(), LossShare { value_share, forward_secs, backward_secs })
        };
        history.loss_sums.iter().map(share).collect()
    }

    /// The notices of the steps, and one for parameters that stopped learning. An earlier training may have reported the
    /// same of its phases.
    fn notices(&self) -> Vec<String> {
        let mut notices = self.telemetry.history.notices.clone();
        for (phase, influence) in &self.telemetry.history.influence {
            for Stalled { groups, last, samples: [later, all] } in influence.stalled() {
                let notice = format!(
                    "no gradient reached {} after step {last} of phase {phase} (the last {later} of {all} samples): these \
                     parameters stopped learning, e.g. because all units of a layer are switched off",
                    groups.join(", "),
                );
                if !notices.contains(&notice) {
                    notices.push(notice);
                }
            }
        }
        notices
    }

    /// The influence of every loss, with the effect that it belongs to.
    fn influence(&self) -> BTreeMap<String, PhaseInfluence> {
        let declared = self.setup.params.registration().losses;
        let mut influence = self.telemetry.history.influence.clone();
        for (name, loss) in influence.values_mut().flat_map(|phase| &mut phase.losses) {
            let found = declared.iter().find(|declared| declared.name == name);
            loss.effect = found.and_then(|declared| declared.effect).map(str::to_owned);
            loss.stays = found.and_then(|declared| declared.stays).map(str::to_owned);
        }
        influence
    }
}

/// Milliseconds per step of every activity in every phase that has begun; the last of `phases` has completed
/// `iteration` steps.
fn milliseconds_by_phase(
    clock: &ClockReading,
    phases: &[Phase],
    iteration: u64,
) -> BTreeMap<String, BTreeMap<String, f64>> {
    let steps = |at: usize| if at + 1 < phases.len() { phases[at].iterations } else { iteration };
    let per_step = |at: usize| {
        let phase = phases[at].name.to_string();
        let own = clock.secs.get(&phase)?.iter().filter(|(activity, _)| !UNCLOCKED.contains(&activity.as_str()));
        let scaled = own.map(|(activity, secs)| (activity.clone(), 1e3 * secs / steps(at).max(1) as f64)).collect();
        Some((phase, scaled))
    };
    (0..phases.len()).filter_map(per_step).collect()
}

/// Milliseconds per call of every kernel, forward and backward.
fn kernel_milliseconds(profile: &Profile) -> BTreeMap<String, [f64; 2]> {
    let mean = |cost: &shaders::tape::Cost| 1e3 * cost.secs / cost.calls.max(1) as f64;
    profile.ops.iter().map(|(name, cost)| (name.to_string(), [mean(&cost.forward), mean(&cost.backward)])).collect()
}
