//! Costs of trainings: time by phase and loss, skipped work, placement of particles.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Costs of one training, or means over several.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Costs {
    /// Milliseconds per iteration by phase (`coarse`, `fine`) and activity (`motion`, `backward`).
    pub ms_per_iteration_by_phase: BTreeMap<String, BTreeMap<String, f64>>,
    /// Share and time of every loss, by name.
    pub loss_shares: BTreeMap<String, LossShare>,
    /// Skipped and total number of items, by kind of work.
    pub skipped_work: BTreeMap<String, [u64; 2]>,
    /// Values that the parts of a method report about the trained models, by name.
    pub figures: BTreeMap<String, f64>,
    /// Moving shares of the initial particles, if the capture has ground truth for motion.
    pub particles_moving: Option<MovingShares>,
}

/// Moving share of the sampled surface, and of the particles sampled from it; both in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MovingShares {
    /// Moving share of the pixels with depth at the first instant.
    pub of_area: f64,
    /// Moving share of the particles.
    pub of_particles: f64,
}

/// Contribution and cost of one loss.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossShare {
    /// Share of the total loss: weighted values summed over all steps, in [0, 1].
    pub value_share: f64,
    /// Seconds of the loss's forward pass, if its method measures them.
    pub forward_secs: Option<f64>,
    /// Estimated seconds of a backward pass of this loss alone.
    #[serde(default)]
    pub backward_secs: Option<f64>,
}

impl Costs {
    /// Means over several runs; counts of skipped work are summed.
    pub(crate) fn mean<'a>(runs: impl Iterator<Item = &'a Self> + Clone) -> Self {
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
                let pairs =
                    [(share.forward_secs, &mut sum.forward_secs), (share.backward_secs, &mut sum.backward_secs)];
                for (secs, sum) in pairs.into_iter().filter_map(|(secs, sum)| Some((secs?, sum))) {
                    *sum.get_or_insert(0.0) += secs / count;
                }
            }
            for (name, figure) in &run.figures {
                let count = runs.clone().filter(|other| other.figures.contains_key(name)).count();
                *total.figures.entry(name.clone()).or_default() += figure / count as f64;
            }
            for (work, [skipped, of]) in &run.skipped_work {
                let sum = total.skipped_work.entry(work.clone()).or_default();
                sum[0] += skipped;
                sum[1] += of;
            }
        }
        total.particles_moving = MovingShares::mean(runs.filter_map(|run| run.particles_moving));
        total
    }

    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        let times = self.ms_per_iteration_by_phase.values().flat_map(BTreeMap::values);
        let shares = self
            .loss_shares
            .values()
            .flat_map(|share| [Some(share.value_share), share.forward_secs, share.backward_secs]);
        let moving = self.particles_moving.iter().flat_map(|shares| [shares.of_area, shares.of_particles]);
        let figures = self.figures.values().copied();
        times.copied().chain(shares.flatten()).chain(figures).chain(moving).all(f64::is_finite)
    }
}

impl MovingShares {
    fn mean(all: impl Iterator<Item = Self>) -> Option<Self> {
        let all: Vec<Self> = all.collect();
        let mean = |of: fn(&Self) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        (!all.is_empty())
            .then(|| Self { of_area: mean(|shares| shares.of_area), of_particles: mean(|shares| shares.of_particles) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn costs(ms: f64, skipped: u64) -> Costs {
        Costs {
            ms_per_iteration_by_phase: [("fine".into(), [("motion".into(), ms)].into())].into(),
            loss_shares: [(
                "flow".into(),
                LossShare { value_share: 0.01 * ms, forward_secs: Some(ms), backward_secs: Some(2.0 * ms) },
            )]
            .into(),
            skipped_work: [("static Gaussians".into(), [skipped, 10])].into(),
            figures: [("active (%)".into(), 10.0 * ms)].into(),
            particles_moving: Some(MovingShares { of_area: 0.1, of_particles: 0.1 * ms }),
        }
    }

    #[test]
    fn times_are_averaged_and_counts_are_summed() {
        let runs = [costs(2.0, 3), costs(4.0, 5), Costs::default()];
        let mean = Costs::mean(runs.iter());
        assert_eq!(mean.ms_per_iteration_by_phase["fine"]["motion"], 3.0, "over the runs that have the phase");
        assert_eq!(mean.loss_shares["flow"].forward_secs, Some(3.0));
        assert_eq!(mean.loss_shares["flow"].backward_secs, Some(6.0));
        assert_eq!(mean.figures["active (%)"], 30.0, "over the runs that have the figure");
        assert_eq!(mean.skipped_work["static Gaussians"], [8, 20]);
        assert!((mean.particles_moving.unwrap().of_particles - 0.3).abs() <= 1e-12);
        assert_eq!(Costs::mean([Costs::default()].iter()).particles_moving, None);
        assert!(mean.is_finite() && !costs(f64::NAN, 0).is_finite());
    }
}
