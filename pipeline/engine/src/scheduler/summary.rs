//! The summary of a run.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::event::{Counts, NodeResult, Outcome};
use crate::{Failure, FailureKind, exit};

/// The summary of a run, stored as `summary.json` in its folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunSummary {
    /// The run's name.
    pub run: String,
    /// The recipe's name.
    pub recipe: String,
    /// The number of jobs with each outcome.
    pub counts: Counts,
    /// The wall time of the run in seconds.
    pub wall_secs: f64,
    /// The signal that stopped the run, if it was stopped.
    pub stopped_by: Option<String>,
    /// The names of the selected nodes without selected consumers: the goals of the run.
    pub sinks: Vec<String>,
    /// The error that kept the events or this summary out of the run's folder, if there was one.
    #[serde(default)]
    pub not_kept: Option<String>,
    /// The result of each node.
    pub results: BTreeMap<String, NodeResult>,
}

impl RunSummary {
    /// The program's exit code (see [`exit`]). Missing data alone is not a failure if a sink has a result that depends
    /// on available data, unless `require_data` is set.
    pub fn exit_code(&self, require_data: bool) -> u8 {
        let counts = &self.counts;
        if let Some(signal) = &self.stopped_by {
            return match signal.as_str() {
                "TERM" => exit::TERMINATED,
                "PIPE" => exit::READER_GONE,
                "USR1" => exit::CHECKPOINTED,
                _ => exit::INTERRUPTED,
            };
        }
        if self.not_kept.is_some() {
            return exit::INFRASTRUCTURE;
        }
        if self.failures().any(|(_, _, failure)| failure.kind == FailureKind::World) {
            return exit::INFRASTRUCTURE;
        }
        if counts.failed + counts.interrupted + counts.not_run > 0 {
            return exit::FAILED;
        }
        if counts.missing_data > 0 && require_data {
            return exit::FAILED;
        }
        let some_sink_is_done = self.sinks.iter().any(|name| self.is_done(name));
        // A table of nothing but missing data has a result, too, but it is not a success.
        let is_inner = |name: &&String| !self.sinks.contains(name);
        let has_data = counts.missing_data == 0 || self.results.keys().filter(is_inner).any(|name| self.is_done(name));
        if some_sink_is_done && has_data { exit::OK } else { exit::NOTHING }
    }

    /// The failed jobs: name, result and failure, ordered by name.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &NodeResult, &Failure)> {
        let failed = self.results.iter().filter(|(_, result)| result.outcome == Outcome::Failed);
        failed.filter_map(|(name, result)| Some((name.as_str(), result, result.failure.as_ref()?)))
    }

    fn is_done(&self, name: &str) -> bool {
        self.results.get(name).is_some_and(|result| matches!(result.outcome, Outcome::Cached | Outcome::Executed))
    }
}
