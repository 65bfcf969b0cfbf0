//! Jobs: each is a child process of the same binary, supervised by one thread of the scheduler.

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
use crate::{Coordinates, DeviceClass, Digest, Failure, KeyComponents, Progress, Work};

pub use child::{Ended, ProcessHandle, Stop, supervise};
pub use exec::execute;
pub use log::{check_filter as check_log_filter, warnings};
pub use signals::StopRequests;

/// The specification of a job for its child process, written to `job.json` in the job's folder.
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
    /// Everything that the result depends on; the digest is the action key.
    pub components: KeyComponents,
    /// The sources of workspace crates that cannot influence the result.
    pub unused_sources: UnusedSources,
    /// The producers on each port.
    pub inputs: BTreeMap<String, Vec<InputSpec>>,
    /// The sources by name.
    pub sources: BTreeMap<String, SourceSpec>,
    /// The number of threads that the job may use.
    pub threads: usize,
    /// The expected work, which is recorded with the measured time.
    pub work: Option<Work>,
    /// The device that the job computes on.
    pub device: String,
    /// The device class of the run, for jobs that compute on a device.
    pub device_of_run: DeviceClass,
    /// Whether to profile the job.
    pub profile: bool,
    /// The share of its work after which the job pauses, with a checkpoint.
    pub pause_at: Option<f64>,
    /// Whether the result replaces an earlier record of the same key (`--force`).
    pub replace: bool,
    /// The filter of the job's log, e.g. `info` or `training=debug`.
    pub log_filter: String,
    /// The folder for logs and status.
    pub dir: PathBuf,
    /// The id of the scheduler's process. The job stops when that process dies.
    pub parent_pid: u32,
}

/// A producer on one of the job's ports.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InputSpec {
    /// The producer's node name.
    pub producer: String,
    /// The producer's axis values.
    pub coordinates: Coordinates,
    /// The digest of the artifact, or the failure of the producer.
    pub artifact: Result<Digest, Failure>,
    /// The digest of the measurements, if the port reads or relays them.
    pub measurements: Option<Digest>,
    /// The action key; empty if the producer has none.
    pub action_key: String,
}

/// A source, in the state in which it was digested.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SourceSpec {
    /// The absolute path.
    pub path: PathBuf,
    /// The `stat` digest of all files, which is compared again after the job.
    pub stat: Digest,
}

/// The status of a finished job, which the child writes to `status.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JobStatus {
    /// The job published its artifact.
    Published {
        /// The digest of the artifact.
        content: Digest,
        /// The digest of the measurements.
        measurements: Digest,
        /// A remark for the user, e.g. "not recorded: the source changed".
        note: Option<String>,
    },
    /// The job failed.
    Failed(Failure),
}

/// A line that the child writes to its standard output.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Line {
    Progress(Progress),
}
