//! What happens during a run, as data. Every display is a consumer of these; they are kept in `events.jsonl`.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use crate::store::naming;
use crate::{Digest, Failure, Progress};

/// One thing that happened.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The run begins.
    Planned {
        /// The run's name.
        run: String,
        /// The recipe's name.
        recipe: String,
        /// How many jobs are to be at rest at the end.
        jobs: usize,
    },
    /// A job's process runs.
    Started {
        /// The node's name.
        node: String,
        /// The action key.
        key: String,
        /// Threads that it may use.
        threads: usize,
    },
    /// Another run works on the same action; this one waits for its result.
    Waiting {
        /// The node's name.
        node: String,
    },
    /// A job got further.
    Progress {
        /// The node's name.
        node: String,
        /// How far.
        progress: Progress,
    },
    /// A job is at rest.
    Finished {
        /// The node's name.
        node: String,
        /// What became of it.
        #[serde(flatten)]
        result: NodeResult,
    },
    /// Still there.
    Heartbeat {
        /// Counts of jobs.
        counts: Counts,
        /// What runs, and how far it is.
        running: Vec<(String, Progress)>,
    },
    /// The user asked to stop.
    Stopping {
        /// What is being done about it.
        message: String,
    },
    /// Something that the user should know and that stops nothing.
    Warning {
        /// What.
        message: String,
    },
    /// The run is over.
    RunFinished {
        /// Counts of jobs.
        counts: Counts,
        /// Wall time of the run.
        wall_secs: f64,
    },
}

/// What became of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Its result was there.
    Cached,
    /// It ran and its result is there now.
    Executed,
    /// It ran and failed.
    Failed,
    /// A source that it reads is not on this machine.
    MissingData,
    /// Something that it needs failed or is missing.
    Skipped,
    /// It was stopped on request; what it saved is used next time.
    Interrupted,
    /// The run ended before its turn came.
    NotRun,
}

/// What became of a job, with the details.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NodeResult {
    /// In one word.
    pub outcome: Outcome,
    /// The action key, if it was known.
    pub key: Option<String>,
    /// The artifact, if there is one.
    pub content: Option<Digest>,
    /// Why there is none; for a skipped job, why the job that it needs has none.
    pub failure: Option<Failure>,
    /// For a skipped job, the job that it needs.
    pub because_of: Option<String>,
    /// Wall time, if it ran.
    pub wall_secs: Option<f64>,
    /// The folder with its logs, if it ran.
    pub log_dir: Option<PathBuf>,
    /// Something that the user should know.
    pub note: Option<String>,
}

impl NodeResult {
    /// A result that is only its outcome.
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

/// How many jobs are where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// All jobs of the run.
    pub total: usize,
    /// Running now.
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
    /// Counts one more job at rest.
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

    /// Jobs whose result is there.
    pub fn done(&self) -> usize {
        self.cached + self.executed
    }
}

/// An event with its time, one line of `events.jsonl`.
#[derive(Serialize)]
struct Line<'a> {
    at_secs: f64,
    #[serde(flatten)]
    event: &'a Event,
}

/// One line of JSON for an event, with the seconds since 1970.
pub fn json_line(event: &Event) -> serde_json::Result<String> {
    let at_secs = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    serde_json::to_string(&Line { at_secs, event })
}

/// Writes events to a file and shows them to whoever watches.
pub(crate) struct EventLog<'a> {
    file: BufWriter<File>,
    path: PathBuf,
    /// The first error of writing the file. What a run makes matters more than its diary: the run goes on.
    fault: Option<io::Error>,
    watcher: &'a mut dyn FnMut(&Event),
}

impl<'a> EventLog<'a> {
    pub(crate) fn create(path: &Path, watcher: &'a mut dyn FnMut(&Event)) -> io::Result<Self> {
        let file = File::options().create(true).append(true).open(path).map_err(naming(path))?;
        Ok(Self { file: BufWriter::new(file), path: path.to_owned(), fault: None, watcher })
    }

    pub(crate) fn emit(&mut self, event: &Event) {
        let written = json_line(event).map_err(io::Error::from).and_then(|line| writeln!(self.file, "{line}"));
        self.note(written);
        (self.watcher)(event);
    }

    /// Hands what was written to the system, so that others can follow the file.
    pub(crate) fn flush(&mut self) {
        let flushed = self.file.flush();
        self.note(flushed);
    }

    /// Why the file is not complete, if so.
    pub(crate) fn fault(&self) -> Option<String> {
        self.fault.as_ref().map(|error| format!("cannot write the run's events ({error}): {}", self.path.display()))
    }

    fn note(&mut self, written: io::Result<()>) {
        self.fault = self.fault.take().or(written.err());
    }
}
