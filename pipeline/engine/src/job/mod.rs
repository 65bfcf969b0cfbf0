//! One job: one child process of the same binary, watched by one thread of the scheduler.

mod child;
mod exec;
mod failure;
mod log;
mod machine;
mod signals;

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::fingerprint::UnusedSources;
use crate::{Coordinates, DeviceClass, Digest, Failure, KeyComponents, Progress};

pub use child::{Ended, ProcessHandle, Stop, supervise};
pub use exec::execute;
pub use log::check_filter as check_log_filter;
pub use signals::StopRequests;

/// Everything that a child needs to know, written to `job.json` in the job's folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct JobSpec {
    /// The store's folder.
    pub store: PathBuf,
    /// The run that the job belongs to.
    pub run: String,
    /// The recipe's name.
    pub recipe: String,
    /// The node's name.
    pub node: String,
    /// The node's plan id.
    pub plan_id: String,
    /// The node's axis values.
    pub coordinates: Coordinates,
    /// What the result depends on; its digest is the action key.
    pub components: KeyComponents,
    /// The sources below the stage that cannot influence the result.
    pub unused_sources: UnusedSources,
    /// Producers by port.
    pub inputs: BTreeMap<String, Vec<InputSpec>>,
    /// Sources by name.
    pub sources: BTreeMap<String, SourceSpec>,
    /// Threads that the job may use.
    pub threads: usize,
    /// The device that it computes on.
    pub device: String,
    /// What the run's jobs compute on that compute on a device.
    pub device_of_run: DeviceClass,
    /// Whether it measures closely.
    pub profile: bool,
    /// Whether the result replaces an earlier record of the same key (`--force`).
    pub replace: bool,
    /// Filter of the job's log, as `info` or `training=debug`.
    pub log_filter: String,
    /// Where logs and status go.
    pub dir: PathBuf,
    /// The scheduler's process: when it is gone, the job stops too.
    pub parent_pid: u32,
}

/// A producer as the child finds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InputSpec {
    /// The producer's node name.
    pub producer: String,
    /// The producer's axis values.
    pub coordinates: Coordinates,
    /// The digest of its artifact, or why there is none.
    pub artifact: Result<Digest, Failure>,
    /// The digest of its measurements, if the port reads them.
    pub measurements: Option<Digest>,
    /// Its action key; empty if it has none.
    pub action_key: String,
}

/// A source as it was when it was digested.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SourceSpec {
    /// Absolute.
    pub path: PathBuf,
    /// What `stat` said of all its files; compared after the job.
    pub stat: Digest,
}

/// What the child leaves in `status.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JobStatus {
    /// The artifact is in the store.
    Published {
        /// The digest of the artifact.
        content: Digest,
        /// The digest of the measurements.
        measurements: Digest,
        /// Something that the user should know, as "not recorded: the source changed".
        note: Option<String>,
    },
    /// There is no artifact.
    Failed(Failure),
}

/// One line on the child's standard output.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Line {
    Progress(Progress),
}
