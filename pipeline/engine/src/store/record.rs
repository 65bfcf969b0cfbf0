//! Action records: what a job made, from what, when and where.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::PathBuf;

use anyhow::Context;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{Store, naming};
use crate::{ActionKey, DeviceClass, Digest, Failure, KeyComponents};

/// The version of both record types. A record of another version is a miss.
const VERSION: u32 = 1;

/// A finished action. Its existence is what makes a later run skip the job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ActionRecord {
    version: u32,
    /// The digest of `components`.
    pub key: ActionKey,
    /// Everything that the result depends on.
    pub components: KeyComponents,
    /// Who made it.
    pub provenance: Provenance,
    /// The digest of the artifact's manifest.
    pub content: Digest,
    /// The size of the artifact.
    pub size_bytes: u64,
    /// The number of files in the artifact.
    pub files: usize,
    /// The digest of the measurements' JSON.
    pub measurements: Digest,
}

/// An action that failed. Kept for people; never a cache hit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailureRecord {
    version: u32,
    /// The digest of `components`.
    pub key: ActionKey,
    /// Everything that the result would have depended on.
    pub components: KeyComponents,
    /// Who tried.
    pub provenance: Provenance,
    /// Why it failed.
    pub failure: Failure,
    /// The last lines of its log.
    pub log_tail: Vec<String>,
}

/// Who ran an action, when and where; never part of a key.
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
    /// What the run had its jobs compute on that compute on a device; also where this job does not.
    #[serde(default)]
    pub device: DeviceClass,
    /// The machine's name.
    pub host: String,
    /// The job's threads.
    pub threads: usize,
    /// Start, in seconds since 1970.
    pub started_at_secs: f64,
    /// Wall time of the last (uninterrupted) attempt.
    pub wall_secs: f64,
    /// The job's largest resident memory, where the system tells.
    pub peak_rss_bytes: Option<u64>,
}

impl ActionRecord {
    /// A record of what `publication` put into the store.
    pub fn new(components: KeyComponents, provenance: Provenance, publication: &super::Publication) -> Self {
        let super::Publication { content, measurements, size_bytes, files } = *publication;
        let key = ActionKey::new(&components);
        Self { version: VERSION, key, components, provenance, content, size_bytes, files, measurements }
    }
}

impl FailureRecord {
    /// A record of a failure.
    pub fn new(components: KeyComponents, provenance: Provenance, failure: Failure, log_tail: Vec<String>) -> Self {
        Self { version: VERSION, key: ActionKey::new(&components), components, provenance, failure, log_tail }
    }
}

impl Store {
    pub(super) fn record_path(&self, key: &ActionKey) -> PathBuf {
        self.root.join("records").join(format!("{key}.json"))
    }

    fn failure_path(&self, key: &ActionKey) -> PathBuf {
        self.root.join("failures").join(format!("{key}.json"))
    }

    /// Commits a publication. The first record of a key wins: `false` if one was there already.
    pub fn put_record(&self, record: &ActionRecord) -> anyhow::Result<bool> {
        let bytes = serde_json::to_vec_pretty(record)?;
        match self.write_new(&self.record_path(&record.key), &bytes) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
            other => other.map(|()| true).context("cannot write the action record"),
        }
    }

    /// Moves a record aside, so that a forced job's result takes its place.
    pub fn retire_record(&self, key: &ActionKey) -> io::Result<()> {
        match self.record_path(key) {
            path if path.exists() => self.quarantine(&path),
            _ => Ok(()),
        }
    }

    /// Remembers why an action failed; the latest failure replaces earlier ones.
    pub fn put_failure(&self, record: &FailureRecord) -> anyhow::Result<()> {
        let bytes = serde_json::to_vec_pretty(record)?;
        self.write_over(&self.failure_path(&record.key), &bytes).context("cannot write the failure record")
    }

    /// The last failure of this action, if it is newer than nothing else: a success removes it.
    pub fn failure(&self, key: &ActionKey) -> Option<FailureRecord> {
        read_record(&fs::read(self.failure_path(key)).ok()?)
    }

    /// Forgets the failure of an action that has succeeded.
    pub fn clear_failure(&self, key: &ActionKey) {
        // A leftover would only be shown, never believed, so that an error here changes nothing.
        let _ = fs::remove_file(self.failure_path(key));
    }

    /// The record of `key`, if there is a readable one of this version; its blobs are not looked at.
    pub(super) fn read_action_record(&self, key: &ActionKey) -> io::Result<Option<ActionRecord>> {
        let bytes = fs::read(self.record_path(key))?;
        Ok(read_record(&bytes).filter(|record: &ActionRecord| record.version == VERSION && record.key == *key))
    }

    /// All readable records, in no particular order of meaning but always the same one (by key).
    pub fn records(&self) -> io::Result<Vec<ActionRecord>> {
        let folder = self.root.join("records");
        if !self.exists() {
            return Ok(Vec::new());
        }
        let entries = fs::read_dir(&folder).map_err(naming(&folder))?;
        let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
        paths.sort();
        Ok(paths.iter().filter_map(|path| read_record(&fs::read(path).ok()?)).collect())
    }
}

/// A record, or nothing if the bytes are not one: a truncated file is a miss, never a crash.
fn read_record<R: DeserializeOwned>(bytes: &[u8]) -> Option<R> {
    serde_json::from_slice(bytes).ok()
}
