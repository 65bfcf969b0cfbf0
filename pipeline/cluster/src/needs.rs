//! What the batch job of a cell needs, from earlier measurements.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use engine::status::History;
use engine::{Plan, Store};

/// A time limit is this many times the predicted time, plus [`SLACK`].
const SAFETY: f64 = 3.0;
/// The time for starting, reading and publishing.
const SLACK: Duration = Duration::from_secs(600);
/// Memory is requested in this multiple of the largest measured one.
const MEMORY_SAFETY: f64 = 1.5;
/// The least memory that is requested, in MiB.
const LEAST_MIB: u64 = 512;

/// Measured times and memory of earlier jobs.
pub(crate) struct Needs {
    history: History,
    /// The largest memory of a job by stage, in bytes.
    memory: BTreeMap<String, u64>,
}

impl Needs {
    pub(crate) fn read(store: &Store) -> anyhow::Result<Self> {
        let mut memory: BTreeMap<String, u64> = BTreeMap::new();
        for record in store.records()? {
            let bytes = record.provenance.peak_rss_bytes.unwrap_or(0);
            let largest = memory.entry(record.components.stage.clone()).or_default();
            *largest = bytes.max(*largest);
        }
        Ok(Self { history: History::read(store)?, memory })
    }

    /// The time limit for cells of which each has these jobs, doubled with every further attempt; `None` if the time of some
    /// job is unknown.
    pub(crate) fn time(&self, plan: &Plan, cells: &[&BTreeSet<usize>], attempt: usize) -> Option<Duration> {
        let secs = |nodes: &&BTreeSet<usize>| -> Option<f64> {
            nodes.iter().map(|&index| self.history.estimator().secs(plan, &plan.nodes[index])).sum()
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
