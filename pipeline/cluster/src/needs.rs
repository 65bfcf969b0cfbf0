//! The requirements of a cell's batch job, from earlier measurements.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use engine::estimate::Estimator;
use engine::{Plan, Store};

/// A time limit is this many times the predicted time, plus [`SLACK`].
const SAFETY: f64 = 3.0;
/// The time for starting, reading and publishing.
const SLACK: Duration = Duration::from_secs(600);
/// The requested memory is this multiple of the largest measured one.
const MEMORY_SAFETY: f64 = 1.5;
/// The least memory that is requested, in MiB.
const LEAST_MIB: u64 = 512;
/// The lead of the signal is this many times the longest time of saving a checkpoint, plus [`LEAD_SLACK`]: other jobs may
/// save to the same disk at that moment.
const LEAD_SAFETY: f64 = 3.0;
/// The time for finishing a step and for putting the job back into the queue.
const LEAD_SLACK: Duration = Duration::from_secs(30);
/// The lead of the signal if no checkpoint was measured.
const UNMEASURED_LEAD: Duration = Duration::from_secs(120);

/// Measured times and memory of earlier jobs.
pub(crate) struct Needs {
    estimator: Estimator,
    /// The largest memory of a job by stage, in bytes.
    memory: BTreeMap<String, u64>,
    /// The longest time of saving a checkpoint by stage, in seconds.
    checkpoint_secs: BTreeMap<String, f64>,
}

impl Needs {
    pub(crate) fn read(store: &Store) -> anyhow::Result<Self> {
        let mut memory: BTreeMap<String, u64> = BTreeMap::new();
        let mut checkpoint_secs: BTreeMap<String, f64> = BTreeMap::new();
        let records = store.records()?;
        for record in &records {
            let stage = record.components.stage.clone();
            if let Some(secs) = record.provenance.checkpoint_secs {
                let longest = checkpoint_secs.entry(stage.clone()).or_default();
                *longest = secs.max(*longest);
            }
            let bytes = record.provenance.peak_rss_bytes.unwrap_or(0);
            let largest = memory.entry(stage).or_default();
            *largest = bytes.max(*largest);
        }
        Ok(Self { estimator: Estimator::new(records.iter()), memory, checkpoint_secs })
    }

    /// The time before the end of an allocation at which these jobs must save their progress. At most half of the
    /// time `limit`: a job that is warned at its start would be requeued forever.
    pub(crate) fn signal_lead(
        &self,
        plan: &Plan,
        nodes: impl Iterator<Item = usize>,
        limit: Option<Duration>,
    ) -> Duration {
        let measured = nodes.filter_map(|index| self.checkpoint_secs.get(&plan.nodes[index].stage)).copied();
        let lead =
            match measured.fold(None, |longest: Option<f64>, secs| Some(longest.map_or(secs, |old| old.max(secs)))) {
                Some(secs) => Duration::from_secs_f64(secs * LEAD_SAFETY) + LEAD_SLACK,
                None => UNMEASURED_LEAD,
            };
        limit.map_or(lead, |limit| lead.min(limit / 2))
    }

    /// The time limit for cells with these jobs each, doubled with every further attempt; `None` if the time of any job
    /// is unknown.
    pub(crate) fn time(&self, plan: &Plan, cells: &[&BTreeSet<usize>], attempt: usize) -> Option<Duration> {
        let secs = |nodes: &&BTreeSet<usize>| -> Option<f64> {
            nodes.iter().map(|&index| self.estimator.secs(plan, &plan.nodes[index])).sum()
        };
        let longest = cells.iter().map(secs).collect::<Option<Vec<f64>>>()?.into_iter().fold(0.0, f64::max);
        let escalation = f64::from(1 << (attempt.saturating_sub(1)).min(10));
        Some(Duration::try_from_secs_f64(longest * SAFETY * escalation).ok()? + SLACK)
    }

    /// The memory for these jobs, as Slurm writes it; `None` if no job of their stages was measured.
    pub(crate) fn memory(&self, plan: &Plan, nodes: impl Iterator<Item = usize>) -> Option<String> {
        let stages: BTreeSet<&str> = nodes.map(|index| plan.nodes[index].stage.as_str()).collect();
        let largest =
            stages.into_iter().filter_map(|stage| self.memory.get(stage)).max().filter(|bytes| **bytes > 0)?;
        let mib = (*largest as f64 * MEMORY_SAFETY / f64::from(1 << 20)).ceil() as u64;
        Some(format!("{}M", mib.max(LEAST_MIB)))
    }
}

#[cfg(test)]
mod tests {
    use engine::Work;

    use super::*;

    #[test]
    fn limits_follow_measurements_and_grow_with_each_attempt() {
        let mut plan = crate::cells::tests::plan("train");
        plan.nodes[0].stage = "training".into();
        plan.nodes[0].work = Some(Work { kind: "a".into(), amounts: [10.0, 1.0] });
        let cell = BTreeSet::from([0]);
        let mut needs = Needs {
            estimator: Estimator::default(),
            memory: BTreeMap::from([("training".into(), 1 << 30)]),
            checkpoint_secs: BTreeMap::new(),
        };
        assert_eq!(needs.time(&plan, &[&cell], 1), None);
        needs.estimator.add_run(&plan, &plan.nodes[0], 1000.0);
        let time = |attempt| needs.time(&plan, &[&cell], attempt).unwrap().as_secs_f64().round();
        assert_eq!([1, 2, 3].map(time), [3600.0, 6600.0, 12600.0]);
        assert_eq!(needs.memory(&plan, 0..1).unwrap(), "1536M");
    }

    #[test]
    fn the_lead_of_the_signal_follows_the_longest_measured_checkpoint() {
        let mut plan = crate::cells::tests::plan("train");
        plan.nodes[0].stage = "training".into();
        let needs = |measured: &[(&str, f64)]| Needs {
            estimator: Estimator::default(),
            memory: BTreeMap::new(),
            checkpoint_secs: measured.iter().map(|(stage, secs)| ((*stage).into(), *secs)).collect(),
        };
        let lead = |measured: &[(&str, f64)], limit: Option<u64>| {
            needs(measured).signal_lead(&plan, 0..plan.nodes.len(), limit.map(Duration::from_secs)).as_secs_f64()
        };
        assert_eq!(lead(&[], None), 120.0);
        assert_eq!(lead(&[("training", 10.0), ("other", 99.0)], Some(3600)), 60.0);
        assert_eq!(lead(&[("training", 200.0)], Some(3600)), 630.0);
        assert_eq!(lead(&[("training", 200.0)], Some(60)), 30.0, "a job makes progress before it is warned");
    }
}
