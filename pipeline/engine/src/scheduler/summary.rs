//! What a run came to.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::event::{Counts, NodeResult, Outcome};
use crate::{Failure, exit};

/// What a run came to; kept as `summary.json` in its folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunSummary {
    /// The run's name.
    pub run: String,
    /// The recipe's name.
    pub recipe: String,
    /// How many jobs came to what.
    pub counts: Counts,
    /// Wall time of the run.
    pub wall_secs: f64,
    /// The signal that stopped it, if one did.
    pub stopped_by: Option<String>,
    /// The nodes that nothing reads: what the run was for.
    pub sinks: Vec<String>,
    /// Why events or this summary could not be kept in the run's folder, if so.
    #[serde(default)]
    pub not_kept: Option<String>,
    /// What became of each node.
    pub results: BTreeMap<String, NodeResult>,
}

impl RunSummary {
    /// The program's exit code (see [`exit`]). Missing data alone is no failure while anything at the end of the
    /// graph could be made of data that is there, unless the user requires all data.
    pub fn exit_code(&self, require_data: bool) -> u8 {
        let counts = &self.counts;
        if let Some(signal) = &self.stopped_by {
            return match signal.as_str() {
                "TERM" => exit::TERMINATED,
                "PIPE" => exit::READER_GONE,
                _ => exit::INTERRUPTED,
            };
        }
        if self.not_kept.is_some() {
            return exit::INFRASTRUCTURE;
        }
        if counts.failed + counts.interrupted + counts.not_run > 0 {
            return exit::FAILED;
        }
        if counts.missing_data > 0 && require_data {
            return exit::FAILED;
        }
        let some_sink_is_done = self.sinks.iter().any(|name| self.is_done(name));
        // A table that shows nothing but missing data is made all the same; it is no success.
        let on_the_way = |name: &&String| !self.sinks.contains(name);
        let of_something =
            counts.missing_data == 0 || self.results.keys().filter(on_the_way).any(|name| self.is_done(name));
        if some_sink_is_done && of_something { exit::OK } else { exit::NOTHING }
    }

    /// Failed jobs with their failures, by name.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &NodeResult, &Failure)> {
        let failed = self.results.iter().filter(|(_, result)| result.outcome == Outcome::Failed);
        failed.filter_map(|(name, result)| Some((name.as_str(), result, result.failure.as_ref()?)))
    }

    fn is_done(&self, name: &str) -> bool {
        self.results.get(name).is_some_and(|result| matches!(result.outcome, Outcome::Cached | Outcome::Executed))
    }
}
