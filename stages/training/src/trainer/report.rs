//! What a training measures besides its model.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shaders::tape::Profile;

use super::{EVALUATION, LargestGradient};
use crate::budget::Choice;
use crate::clock::ClockReading;
use crate::curve::CurvePoint;
use crate::device::GpuUse;
use crate::method::Phase;
use crate::step::SkippedWork;

/// What a training measures besides its model.
#[derive(Clone, Debug)]
pub struct Report {
    /// Seconds, evaluation excluded.
    pub training_secs: f64,
    /// How the schedule was chosen, where there was a budget.
    pub budget: Option<Choice>,
    /// Seconds, evaluation included.
    pub total_secs: f64,
    /// Training time per step.
    pub ms_per_iteration: f64,
    /// Training time per step by phase and activity, milliseconds.
    pub ms_per_iteration_by_phase: BTreeMap<String, BTreeMap<String, f64>>,
    /// Each loss's share of the value and of the time.
    pub loss_shares: BTreeMap<String, LossShare>,
    /// Weighted values summed over steps, by loss.
    pub loss_sums: BTreeMap<String, f64>,
    /// Seconds per activity.
    pub phases: BTreeMap<String, f64>,
    /// Seconds per phase and activity.
    pub seconds_by_phase: ClockReading,
    /// Quality over seconds.
    pub curve: Vec<CurvePoint>,
    /// The split that the curve was measured on.
    pub curve_split: scene::Split,
    /// Milliseconds per call of every kernel, forward and backward, since the last resumption.
    pub kernels: BTreeMap<String, [f64; 2]>,
    /// What a step asked of the GPU since the last resumption, if it computes on one.
    pub gpu: Option<GpuUse>,
    /// Work left out because nothing called for it, since the last resumption.
    pub skipped: SkippedWork,
    /// The largest gradient of every tensor, since the last resumption.
    pub largest_gradients: BTreeMap<String, LargestGradient>,
    /// How often the rasteriser kept a number in range, summed over renders since the last resumption.
    pub guards: BTreeMap<&'static str, u64>,
}

/// What a training measured that another one goes on from.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Earlier {
    /// Seconds by phase and activity.
    #[serde(rename = "seconds_by_phase")]
    pub clock: ClockReading,
    /// Quality over seconds.
    pub curve: Vec<CurvePoint>,
    /// Weighted values summed over steps, by loss.
    #[serde(rename = "loss_sums")]
    pub losses: BTreeMap<String, f64>,
}

/// What one loss contributes, and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossShare {
    /// Of the sum of all weighted values over all steps.
    pub value_share: f64,
    /// Seconds of its forward pass, where its method clocks it as `loss NAME`.
    pub forward_secs: Option<f64>,
}

/// The share of every loss in the sum of all, and its seconds.
pub(super) fn loss_shares(sums: &BTreeMap<String, f64>, clock: &ClockReading) -> BTreeMap<String, LossShare> {
    let total: f64 = sums.values().map(|sum| sum.abs()).sum();
    let activities = clock.by_activity();
    let share = |(name, sum): (&String, &f64)| {
        let forward_secs = activities.get(&format!("loss {name}")).copied();
        let value_share = if total > 0.0 { sum.abs() / total } else { 0.0 };
        (name.clone(), LossShare { value_share, forward_secs })
    };
    sums.iter().map(share).collect()
}

/// Milliseconds per step of every activity in every phase that has begun; the last of `phases` has done `iteration` steps.
pub(super) fn milliseconds_by_phase(
    clock: &ClockReading,
    phases: &[Phase],
    iteration: u64,
) -> BTreeMap<String, BTreeMap<String, f64>> {
    let steps = |at: usize| if at + 1 < phases.len() { phases[at].iterations } else { iteration };
    let per_step = |at: usize| {
        let phase = phases[at].name.to_string();
        let own = clock.secs.get(&phase)?.iter().filter(|(activity, _)| *activity != EVALUATION);
        let scaled = own.map(|(activity, secs)| (activity.clone(), 1e3 * secs / steps(at).max(1) as f64)).collect();
        Some((phase, scaled))
    };
    (0..phases.len()).filter_map(per_step).collect()
}

/// Milliseconds per call of every kernel, forward and backward.
pub(super) fn kernel_milliseconds(profile: &Profile) -> BTreeMap<String, [f64; 2]> {
    let mean = |cost: &shaders::tape::Cost| 1e3 * cost.secs / cost.calls.max(1) as f64;
    profile.ops.iter().map(|(name, cost)| (name.to_string(), [mean(&cost.forward), mean(&cost.backward)])).collect()
}
