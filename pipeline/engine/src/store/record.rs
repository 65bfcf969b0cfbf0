//! Action records: the results and failures of jobs, with their keys and provenance.

use std::io::{self, ErrorKind};
use std::path::PathBuf;

use anyhow::Context;
use fs_err as fs;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Store;
use crate::{ActionKey, DeviceClass, Digest, Failure, KeyComponents, Work};

/// The version of both record types. A lookup treats an action record of another version as damaged.
const VERSION: u32 = 1;

/// A finished action. Later runs reuse its result.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ActionRecord {
    version: u32,
    /// The digest of `components`.
    pub key: ActionKey,
    /// Everything that the result depends on.
    pub components: KeyComponents,
    /// The job that made it.
    pub provenance: Provenance,
    /// The digest of the artifact's manifest.
    pub content: Digest,
    /// The size of the artifact in bytes.
    pub size_bytes: u64,
    /// The number of files in the artifact.
    pub files: usize,
    /// The digest of the measurements' JSON.
    pub measurements: Digest,
}

/// A failed action, recorded for the user and for the other processes of a shared run. Never a cache hit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailureRecord {
    version: u32,
    /// The digest of `components`.
    pub key: ActionKey,
    /// Everything that the result would have depended on.
    pub components: KeyComponents,
    /// The job that failed.
    pub provenance: Provenance,
    /// The failure.
    pub failure: Failure,
    /// The last lines of the job's logs.
    pub log_tail: Vec<String>,
    /// The folder with the job's logs.
    #[serde(default)]
    pub log_dir: PathBuf,
}

/// The job that ran an action, with time and machine. Never part of a key.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The recipe's name.
    pub recipe: String,
    /// The node's name.
    pub node: String,
    /// The node's plan id.
    pub plan_id: String,
    /// The run that executed the job.
    pub run: String,
    /// The device class of the run, even if this job does not compute on a device.
    #[serde(default)]
    pub device: DeviceClass,
    /// The machine's name.
    pub host: String,
    /// The number of threads of the job.
    pub threads: usize,
    /// The work that the job was expected to be; none if it continued from a checkpoint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work: Option<Work>,
    /// The start in seconds since 1970.
    pub started_at_secs: f64,
    /// The wall time in seconds of the last attempt, without earlier, interrupted ones.
    pub wall_secs: f64,
    /// The peak resident memory in bytes, if the system reports it.
    pub peak_rss_bytes: Option<u64>,
    /// The longest time of saving a checkpoint in the last attempt, seconds; none if it saved none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checkpoint_secs: Option<f64>,
}

impl ActionRecord {
    /// Creates the record of a published artifact.
    pub fn new(components: KeyComponents, provenance: Provenance, publication: &super::Publication) -> Self {
        let super::Publication { content, measurements, size_bytes, files } = *publication;
        let key = ActionKey::new(&components);
        Self { version: VERSION, key, components, provenance, content, size_bytes, files, measurements }
    }
}

impl FailureRecord {
    /// Creates the record of a failure; `log_dir` has the job's logs, with these last lines.
    pub fn new(
        components: KeyComponents,
        provenance: Provenance,
        failure: Failure,
        log_tail: Vec<String>,
        log_dir: PathBuf,
    ) -> Self {
        let key = ActionKey::new(&components);
        Self { version: VERSION, key, components, provenance, failure, log_tail, log_dir }
    }
}

impl Store {
    pub(super) fn record_path(&self, key: &ActionKey) -> PathBuf {
        self.root.join("records").join(format!("{key}.json"))
    }

    fn failure_path(&self, key: &ActionKey) -> PathBuf {
        self.root.join("failures").join(format!("{key}.json"))
    }

    /// Commits a publication. Returns `false` if the key already has a record, which is kept.
    pub fn put_record(&self, record: &ActionRecord) -> anyhow::Result<bool> {
        let bytes = serde_json::to_vec_pretty(record)?;
        match self.write_new(&self.record_path(&record.key), &bytes) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
            other => other.map(|()| true).context("cannot write the action record"),
        }
    }

    /// Moves a record to quarantine, so that the result of a forced job can replace it.
    pub fn retire_record(&self, key: &ActionKey) -> io::Result<()> {
        match self.record_path(key) {
            path if path.exists() => self.quarantine(&path),
            _ => Ok(()),
        }
    }

    /// Records a failure, replacing an earlier failure of the action.
    pub fn put_failure(&self, record: &FailureRecord) -> anyhow::Result<()> {
        let bytes = serde_json::to_vec_pretty(record)?;
        self.write_over(&self.failure_path(&record.key), &bytes).context("cannot write the failure record")
    }

    /// The last failure of this action, unless the action has succeeded since.
    pub fn failure(&self, key: &ActionKey) -> Option<FailureRecord> {
        read_record(&fs::read(self.failure_path(key)).ok()?)
    }

    /// Removes the failure of an action that has succeeded.
    pub fn clear_failure(&self, key: &ActionKey) {
        // An error is ignored: a failure record is never a cache hit.
        let _ = fs::remove_file(self.failure_path(key));
    }

    /// The record of `key`, if it is readable and of this version. Does not check its blobs.
    pub(super) fn read_action_record(&self, key: &ActionKey) -> io::Result<Option<ActionRecord>> {
        let bytes = fs::read(self.record_path(key))?;
        Ok(read_record(&bytes).filter(|record: &ActionRecord| record.version == VERSION && record.key == *key))
    }

    /// All readable records, oldest first.
    pub fn records(&self) -> io::Result<Vec<ActionRecord>> {
        let folder = self.root.join("records");
        if !self.exists() {
            return Ok(Vec::new());
        }
        let entries = fs::read_dir(&folder)?;
        let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
        paths.sort();
        let mut records: Vec<ActionRecord> =
            paths.iter().filter_map(|path| read_record(&fs::read(path).ok()?)).collect();
        records.sort_by(|a, b| a.provenance.started_at_secs.total_cmp(&b.provenance.started_at_secs));
        Ok(records)
    }
}

/// Parses a record; `None` for invalid bytes, e.g. of a truncated file.
fn read_record<R: DeserializeOwned>(bytes: &[u8]) -> Option<R> {
    serde_json::from_slice(bytes).ok()
}
