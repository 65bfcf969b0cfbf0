//! The events of a run. Every display consumes them, and `events.jsonl` records them.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use fs_err::{File, OpenOptions};
use serde::{Deserialize, Serialize};

use crate::{DeviceClass, Digest, Failure, Progress};

/// An event of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The run starts.
    Planned {
        /// The run's name.
        run: String,
        /// The recipe's name.
        recipe: String,
        /// The options of the command line that change the recipe.
        changes: Vec<String>,
        /// The device class of the run.
        device: DeviceClass,
        /// The number of selected jobs.
        jobs: usize,
    },
    /// A job's process has started.
    Started {
        /// The node's name.
        node: String,
        /// The action key.
        key: String,
        /// The number of threads that the job may use.
        threads: usize,
    },
    /// Another process is executing the same action, and this one waits for the result.
    Waiting {
        /// The node's name.
        node: String,
    },
    /// A job reported progress.
    Progress {
        /// The node's name.
        node: String,
        /// The progress.
        progress: Progress,
    },
    /// A job is finished.
    Finished {
        /// The node's name.
        node: String,
        /// The result.
        #[serde(flatten)]
        result: NodeResult,
    },
    /// A periodic heartbeat.
    Heartbeat {
        /// The number of jobs in each state.
        counts: Counts,
        /// The names of the running jobs, with their progress.
        running: Vec<(String, Progress)>,
    },
    /// The user requested a stop.
    Stopping {
        /// The scheduler's reaction.
        message: String,
    },
    /// A problem that does not stop the run.
    Warning {
        /// The problem.
        message: String,
    },
    /// The run has ended.
    RunFinished {
        /// The number of jobs in each state.
        counts: Counts,
        /// The wall time of the run in seconds.
        wall_secs: f64,
    },
}

/// The outcome of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The store already had the result.
    Cached,
    /// The job ran and published its result.
    Executed,
    /// The job ran and failed.
    Failed,
    /// A source of the job is missing on this machine.
    MissingData,
    /// A producer has no result.
    Skipped,
    /// The job was stopped on request. The next run continues from its checkpoint.
    Interrupted,
    /// The run ended before the job was started.
    NotRun,
}

/// The outcome of a job, with details.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NodeResult {
    /// The outcome.
    pub outcome: Outcome,
    /// The action key, if all inputs were known.
    pub key: Option<String>,
    /// The artifact, if there is one.
    pub content: Option<Digest>,
    /// The failure of the job; for a skipped job, the failure of the producer that caused it.
    pub failure: Option<Failure>,
    /// For a skipped job, the name of the failed producer.
    pub because_of: Option<String>,
    /// The wall time in seconds, if the job ran.
    pub wall_secs: Option<f64>,
    /// The folder with the job's logs, if it ran.
    pub log_dir: Option<PathBuf>,
    /// A remark for the user, e.g. that the result was not recorded.
    pub note: Option<String>,
}

impl NodeResult {
    /// A result without details.
    pub fn new(outcome: Outcome) -> Self {
        Self {
            outcome,
            key: None,
            content: None,
            failure: None,
            because_of: None,
            wall_secs: None,
            log_dir: None,
            note: None,
        }
    }
}

/// The number of jobs in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// All selected jobs.
    pub total: usize,
    /// Jobs that are running; in a heartbeat of a process that follows a crew, also those of its workers.
    pub running: usize,
    /// See [`Outcome::Cached`].
    pub cached: usize,
    /// See [`Outcome::Executed`].
    pub executed: usize,
    /// See [`Outcome::Failed`].
    pub failed: usize,
    /// See [`Outcome::MissingData`].
    pub missing_data: usize,
    /// See [`Outcome::Skipped`].
    pub skipped: usize,
    /// See [`Outcome::Interrupted`].
    pub interrupted: usize,
    /// See [`Outcome::NotRun`].
    pub not_run: usize,
}

impl Counts {
    /// Counts a finished job.
    pub fn add(&mut self, outcome: Outcome) {
        *match outcome {
            Outcome::Cached => &mut self.cached,
            Outcome::Executed => &mut self.executed,
            Outcome::Failed => &mut self.failed,
            Outcome::MissingData => &mut self.missing_data,
            Outcome::Skipped => &mut self.skipped,
            Outcome::Interrupted => &mut self.interrupted,
            Outcome::NotRun => &mut self.not_run,
        } += 1;
    }

    /// The number of jobs with a result.
    pub fn done(&self) -> usize {
        self.cached + self.executed
    }
}

/// A line of `events.jsonl`: an event with its time.
#[derive(Serialize)]
struct Line<'a> {
    at_secs: f64,
    #[serde(flatten)]
    event: &'a Event,
}

/// An event as one line of JSON, with the current time in seconds since 1970.
pub fn json_line(event: &Event) -> serde_json::Result<String> {
    let at_secs = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    serde_json::to_string(&Line { at_secs, event })
}

/// Writes events to a file and passes them to a watcher.
pub(crate) struct EventLog<'a> {
    file: BufWriter<File>,
    /// The first error of writing the file. It does not stop the run.
    fault: Option<io::Error>,
    watcher: &'a mut dyn FnMut(&Event),
}

impl<'a> EventLog<'a> {
    /// Opens the file at `path` for appending.
    pub(crate) fn create(path: &Path, watcher: &'a mut dyn FnMut(&Event)) -> io::Result<Self> {
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        Ok(Self { file: BufWriter::new(file), fault: None, watcher })
    }

    /// Writes an event and passes it to the watcher.
    pub(crate) fn emit(&mut self, event: &Event) {
        let written = json_line(event).map_err(io::Error::from).and_then(|line| writeln!(self.file, "{line}"));
        self.note(written);
        (self.watcher)(event);
    }

    /// Flushes the file, so that other processes can follow it.
    pub(crate) fn flush(&mut self) {
        let flushed = self.file.flush();
        self.note(flushed);
    }

    /// The error that made the file incomplete, if there was one.
    pub(crate) fn fault(&self) -> Option<String> {
        self.fault.as_ref().map(|error| format!("cannot write the run's events: {error}"))
    }

    fn note(&mut self, written: io::Result<()>) {
        self.fault = self.fault.take().or(written.err());
    }
}
