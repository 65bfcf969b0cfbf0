//! Claims: which process is working on which action. They save work; correctness never depends on one.
//!
//! A claim is a lease. Its holder writes a beat into the file at regular intervals, through the handle with which it made
//! the file; a process that sees no new beat for the length of the lease may take the claim away, by renaming the file.
//! The former holder notices at its next beat, because another file, or none, is at the path. Processes that claim compare no
//! clocks; only garbage collection compares a claim's time of change with its own clock, to ignore abandoned ones. Three
//! operations must be atomic: creating a name that must not exist, renaming, and reading a name's current file. NFS has all
//! three; it has no lock that all of its servers support.

use std::collections::BTreeSet;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use fs_err as fs;
use serde::{Deserialize, Serialize};

use super::{Store, at_path};
use crate::process::ProcessId;
use crate::{ActionKey, Progress};

/// Beats per lease: a holder may miss several, e.g. while a file server restarts.
const BEATS: u32 = 5;
/// The size of a claim's file. Fixed, so that a beat overwrites the last one completely.
const FILE_BYTES: usize = 1024;
/// The longest status of a job that a claim repeats, in characters.
const MAX_MESSAGE: usize = 100;
/// A claim of another machine without a beat for this long does not keep garbage collection away.
const ABANDONED: Duration = Duration::from_secs(3600);
/// The time that a contender needs at most to return a claim that it took by mistake.
const RETURN: Duration = Duration::from_millis(200);

/// The content of a claim.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Holder {
    /// Distinguishes this claim from all others.
    id: String,
    /// The number of beats so far.
    beat: u64,
    /// The process that made the claim.
    pub process: ProcessId,
    /// The process that runs the job, which outlives a killed holder for a moment.
    pub child: Option<ProcessId>,
    /// The run that the job belongs to.
    pub run: String,
    /// The number of threads of the job.
    pub threads: usize,
    /// The job's progress at the last beat.
    pub progress: Progress,
}

impl Holder {
    fn new(run: &str, threads: usize) -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let process = ProcessId::own();
        let id = format!("{}-{}", process.tag(), COUNT.fetch_add(1, Ordering::Relaxed));
        Self { id, beat: 0, process, child: None, run: run.into(), threads, progress: Progress::default() }
    }

    /// Whether no process is left that works on the action, as far as this machine knows.
    pub fn has_ended(&self) -> bool {
        self.process.has_ended() && self.child.as_ref().is_none_or(ProcessId::has_ended)
    }

    fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec(self)?;
        bytes.resize(FILE_BYTES.max(bytes.len()), b' ');
        Ok(bytes)
    }
}

/// A claim that this process holds. It is released when dropped.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    file: std::fs::File,
    holder: Holder,
}

impl Claim {
    /// The time between two beats of a lease of this length.
    pub fn interval(lease: Duration) -> Duration {
        lease / BEATS
    }

    /// Writes a beat. Returns `false` if the claim was taken away.
    pub fn beat(&mut self, child: Option<u32>, progress: &Progress) -> io::Result<bool> {
        self.holder.beat += 1;
        if self.holder.child.is_none() {
            self.holder.child = child.map(ProcessId::local);
        }
        let message = progress.message.chars().take(MAX_MESSAGE).collect();
        self.holder.progress = Progress { message, ..*progress };
        // An error may mean that the file is gone, which the next lines check.
        let written = self.file.write_all_at(&self.holder.bytes()?, 0).and_then(|()| self.file.sync_data());
        if !self.is_mine()? {
            // A contender that took a fresh claim by mistake returns it at once.
            std::thread::sleep(RETURN);
            return self.is_mine();
        }
        written.map(|()| true)
    }

    fn is_mine(&self) -> io::Result<bool> {
        match fs::read(&self.path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
            // A torn read of our own file counts as our own file.
            Ok(bytes) => Ok(parse(&bytes).is_none_or(|holder| holder.id == self.holder.id)),
            Err(error) => Err(error),
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if self.is_mine().unwrap_or(false) {
            // A claim that stays behind expires.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A contender's observations of a claim.
#[derive(Debug)]
pub struct Watch {
    bytes: Vec<u8>,
    /// The time without a new beat during which this process was awake.
    silence: Duration,
    last_look: Instant,
}

impl Watch {
    /// Adds an observation of the claim. Returns whether its holder has ended or let the lease expire.
    fn has_expired(&mut self, bytes: Vec<u8>, lease: Duration) -> bool {
        if parse(&bytes).is_some_and(|holder| holder.has_ended()) {
            self.bytes = bytes;
            return true;
        }
        // Between two observations this process may have been frozen itself, together with the holder: a gap counts at
        // most as one beat.
        let gap = self.last_look.elapsed().min(Claim::interval(lease));
        self.last_look = Instant::now();
        self.silence = if bytes == self.bytes { self.silence + gap } else { Duration::ZERO };
        self.bytes = bytes;
        self.silence >= lease
    }
}

impl Default for Watch {
    fn default() -> Self {
        Self { bytes: Vec::new(), silence: Duration::ZERO, last_look: Instant::now() }
    }
}

impl Store {
    fn claim_path(&self, key: &str) -> PathBuf {
        self.root.join("claims").join(key)
    }

    /// Claims an action for a job of `run`; `None` if a process has a claim on it.
    pub fn try_claim(&self, key: &ActionKey, run: &str, threads: usize) -> io::Result<Option<Claim>> {
        let (path, holder) = (self.claim_path(key.as_str()), Holder::new(run, threads));
        // Most claims of others are seen here, without writing anything.
        if path.exists() {
            return Ok(None);
        }
        let mut file = self.scratch_file()?;
        file.write_all(&holder.bytes()?).map_err(at_path(&path))?;
        match file.persist_noclobber(&path) {
            Ok(file) => Ok(Some(Claim { path, file, holder })),
            Err(error) if error.error.kind() == ErrorKind::AlreadyExists => Ok(None),
            Err(error) => Err(at_path(&path)(error.error)),
        }
    }

    /// The process that has claimed an action, if there is one that has not certainly ended.
    pub fn holder(&self, key: &ActionKey) -> Option<Holder> {
        parse(&fs::read(self.claim_path(key.as_str())).ok()?).filter(|holder| !holder.has_ended())
    }

    /// Removes the claim on an action if its holder has ended or let the lease expire. Returns whether the action is
    /// unclaimed now. To be called regularly with the same `watch`.
    pub fn break_expired_claim(&self, key: &ActionKey, watch: &mut Watch, lease: Duration) -> io::Result<bool> {
        let path = self.claim_path(key.as_str());
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(true),
            bytes => bytes?,
        };
        if !watch.has_expired(bytes, lease) {
            return Ok(false);
        }
        let taken = self.scratch_file()?.into_temp_path();
        match fs::rename(&path, &taken) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(true),
            renamed => renamed?,
        }
        if fs::read(&taken)? == watch.bytes {
            return Ok(true);
        }
        // The holder lives, or another contender was faster: the claim goes back, unless there is a newer one.
        match fs::hard_link(&taken, &path) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(error),
            _ => Ok(false),
        }
    }

    /// The action keys with a claim.
    pub fn claimed(&self) -> io::Result<BTreeSet<String>> {
        self.keys_in("claims")
    }

    /// The action keys with a file in a folder: one listing instead of one query per key.
    pub(crate) fn keys_in(&self, folder: &str) -> io::Result<BTreeSet<String>> {
        let name = |entry: io::Result<fs::DirEntry>| {
            let name = entry?.file_name().to_string_lossy().into_owned();
            Ok(name.strip_suffix(".json").map(str::to_owned).unwrap_or(name))
        };
        fs::read_dir(self.root.join(folder))?.map(name).collect()
    }

    /// Whether some process, perhaps on another machine, seems to work on a job.
    pub(super) fn has_live_claims(&self) -> io::Result<bool> {
        for key in self.claimed()? {
            let path = self.claim_path(&key);
            let is_old = fs::metadata(&path).and_then(|meta| meta.modified());
            let is_old = is_old.is_ok_and(|at| at.elapsed().is_ok_and(|age| age > ABANDONED));
            let ended = fs::read(&path).ok().and_then(|bytes| parse(&bytes)).is_some_and(|holder| holder.has_ended());
            if !is_old && !ended {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

fn parse(bytes: &[u8]) -> Option<Holder> {
    serde_json::from_slice(bytes).ok()
}

#[cfg(test)]
#[path = "claim_tests.rs"]
mod tests;
