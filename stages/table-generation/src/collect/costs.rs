//! What trainings measure of where their time goes.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What trainings measured, beside their sum.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Costs {
    /// Milliseconds per iteration by phase (`coarse`, `fine`) and activity (`motion`, `backward`).
    pub ms_per_iteration_by_phase: BTreeMap<String, BTreeMap<String, f64>>,
    /// By the loss's name.
    pub loss_shares: BTreeMap<String, LossShare>,
    /// By what was left out: how much of how much.
    pub skipped_work: BTreeMap<String, [u64; 2]>,
}

/// What one loss contributes, and what it takes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossShare {
    /// Of the sum of all weighted values over all steps.
    pub value_share: f64,
    /// Seconds of its forward pass, where its method clocks it.
    pub forward_secs: Option<f64>,
}

impl Costs {
    /// Means over several runs; what was left out is summed.
    pub fn mean<'a>(runs: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let mut total = Self::default();
        for run in runs.clone() {
            for (phase, activities) in &run.ms_per_iteration_by_phase {
                let count = runs.clone().filter(|other| other.ms_per_iteration_by_phase.contains_key(phase)).count();
                let sums = total.ms_per_iteration_by_phase.entry(phase.clone()).or_default();
                for (activity, ms) in activities {
                    *sums.entry(activity.clone()).or_default() += ms / count as f64;
                }
            }
            for (name, share) in &run.loss_shares {
                let count = runs.clone().filter(|other| other.loss_shares.contains_key(name)).count() as f64;
                let sum = total.loss_shares.entry(name.clone()).or_default();
                sum.value_share += share.value_share / count;
                if let Some(secs) = share.forward_secs {
                    *sum.forward_secs.get_or_insert(0.0) += secs / count;
                }
            }
            for (what, [skipped, of]) in &run.skipped_work {
                let sum = total.skipped_work.entry(what.clone()).or_default();
                sum[0] += skipped;
                sum[1] += of;
            }
        }
        total
    }

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let times = self.ms_per_iteration_by_phase.values().flat_map(BTreeMap::values);
        let shares = self.loss_shares.values().flat_map(|share| [share.value_share, share.forward_secs.unwrap_or(0.0)]);
        times.copied().chain(shares).all(f64::is_finite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn costs(ms: f64, skipped: u64) -> Costs {
        Costs {
            ms_per_iteration_by_phase: [("fine".into(), [("motion".into(), ms)].into())].into(),
            loss_shares: [("flow".into(), LossShare { value_share: 0.01 * ms, forward_secs: Some(ms) })].into(),
            skipped_work: [("still Gaussians".into(), [skipped, 10])].into(),
        }
    }

    #[test]
    fn times_are_averaged_and_counts_are_summed() {
        let runs = [costs(2.0, 3), costs(4.0, 5), Costs::default()];
        let mean = Costs::mean(runs.iter());
        assert_eq!(mean.ms_per_iteration_by_phase["fine"]["motion"], 3.0, "over the runs that have the phase");
        assert_eq!(mean.loss_shares["flow"].forward_secs, Some(3.0));
        assert_eq!(mean.skipped_work["still Gaussians"], [8, 20]);
        assert!(mean.is_finite() && !costs(f64::NAN, 0).is_finite());
    }
}
