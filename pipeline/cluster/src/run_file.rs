//! `run.json`: the options that all processes of a shared run have in common, in addition to the plan.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use engine::job::StopRequests;
use engine::scheduler::{RunOptions, Share};
use engine::{Plan, Store};
use fs_err as fs;
use serde::{Deserialize, Serialize};

/// The name of the file in a run's folder.
const NAME: &str = "run.json";
/// The time between two heartbeat events.
const HEARTBEAT: Duration = Duration::from_secs(30);

/// The options of a shared run, as given to its first process.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFile {
    /// The recipe as typed.
    pub recipe: PathBuf,
    /// The folder that sources are relative to, absolute.
    pub data_root: PathBuf,
    /// Indices of the requested nodes in the plan.
    pub targets: BTreeSet<usize>,
    /// Indices of the nodes that run even if the store has their results.
    pub force: BTreeSet<usize>,
    /// The device as typed, for machines other than this one.
    pub device: String,
    /// Whether to profile the jobs.
    pub profile: bool,
    /// Each process launches no more jobs after this many failures.
    pub max_failures: Option<usize>,
    /// Stop jobs that run longer than this.
    pub timeout: Option<Duration>,
    /// The filter of the jobs' logs.
    pub log_filter: String,
    /// After this time without a heartbeat, another process may take over a job.
    pub lease: Duration,
}

/// The options of one process of a shared run.
#[derive(Clone, Debug)]
pub struct Process {
    /// The maximum number of jobs at a time.
    pub jobs: usize,
    /// The maximum number of threads of all jobs together.
    pub threads: usize,
    /// The identifier of the device that jobs compute on.
    pub device: String,
    /// The program that runs a job, with its first arguments.
    pub command: Vec<OsString>,
    /// The stop requests to this process.
    pub stop: StopRequests,
}

impl RunFile {
    /// Writes the file into the folder of `run`.
    pub fn write(&self, store: &Store, run: &str) -> anyhow::Result<()> {
        fs::write(store.run_dir(run).join(NAME), serde_json::to_vec_pretty(self)?).context("cannot describe the run")
    }

    /// Reads the options and the plan of a shared run.
    pub fn read(store: &Store, run: &str) -> anyhow::Result<(Self, Plan)> {
        let dir = store.run_dir(run);
        Ok((read_json(&dir.join(NAME))?, read_json(&dir.join("plan.json"))?))
    }

    /// The name of the recipe of a run, without the rest of its plan, which may be large.
    pub fn recipe_name(store: &Store, run: &str) -> anyhow::Result<String> {
        #[derive(Deserialize)]
        struct Named {
            recipe: String,
        }
        Ok(read_json::<Named>(&store.run_dir(run).join("plan.json"))?.recipe)
    }

    /// Whether a run's folder is that of a shared run.
    pub fn exists(dir: &Path) -> bool {
        dir.join(NAME).exists()
    }

    /// The options of one process of the run.
    pub fn options(&self, process: &Process, share: Share) -> RunOptions {
        RunOptions {
            data_root: self.data_root.clone(),
            targets: self.targets.clone(),
            force: self.force.clone(),
            found: Default::default(),
            jobs: process.jobs,
            threads: process.threads,
            device: process.device.clone(),
            profile: self.profile,
            pause_at: Default::default(),
            max_failures: self.max_failures,
            timeout: self.timeout,
            rehash: false,
            log_filter: self.log_filter.clone(),
            command: process.command.clone(),
            stop: process.stop.clone(),
            heartbeat: HEARTBEAT,
            lease: self.lease,
            share: Some(share),
        }
    }
}

/// Reads a JSON file; the error names it.
pub(crate) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    serde_json::from_slice(&fs::read(path)?).with_context(|| format!("cannot read {}", path.display()))
}
