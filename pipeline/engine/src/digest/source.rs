//! Digests of sources (files and folders outside the store), with a cache of file digests by `stat`.

use std::collections::BTreeMap;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use walkdir::WalkDir;

use crate::Digest;

/// A file changed within this time before it was hashed may change again without a new time stamp, so its row in
/// the cache is not trusted (file systems stamp times as coarsely as 2 s).
const RACY_NANOS: i128 = 2_000_000_000;

/// Why a source has no digest.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// Neither a file nor a folder is there.
    #[error("no such file or folder: {}", .0.display())]
    Missing(PathBuf),
    /// It is there and cannot be read.
    #[error("cannot read {}: {}", .0.display(), .1)]
    Unreadable(PathBuf, io::Error),
    /// A name that is not UTF-8 cannot be part of a digest that is the same everywhere.
    #[error("file name is not UTF-8: {}", .0.display())]
    Name(PathBuf),
}

/// What `stat` says about a file: equal means unchanged.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct Stat {
    dev: u64,
    ino: u64,
    size_bytes: u64,
    mtime_ns: i64,
    ctime_ns: i64,
}

impl Stat {
    fn of(path: &Path) -> io::Result<Self> {
        let meta = std::fs::metadata(path)?;
        let nanos = |secs: i64, nanos: i64| secs.saturating_mul(1_000_000_000).saturating_add(nanos);
        Ok(Self {
            dev: meta.dev(),
            ino: meta.ino(),
            size_bytes: meta.len(),
            mtime_ns: nanos(meta.mtime(), meta.mtime_nsec()),
            ctime_ns: nanos(meta.ctime(), meta.ctime_nsec()),
        })
    }
}

/// One row of the cache: what a file looked like when it had this digest.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    stat: Stat,
    sha256: Digest,
    hashed_at_ns: i64,
}

impl Row {
    /// The digest, if the file looks the same and had not been touched shortly before (or after) it was hashed.
    fn digest_if(&self, stat: &Stat) -> Option<Digest> {
        let newest_ns = i128::from(stat.mtime_ns.max(stat.ctime_ns));
        let settled = newest_ns + RACY_NANOS < i128::from(self.hashed_at_ns);
        (self.stat == *stat && settled).then_some(self.sha256)
    }
}

/// Digests of sources below one data root; remembers file digests in a JSON file between runs.
pub struct SourceDigests {
    rows: Mutex<BTreeMap<PathBuf, Row>>,
    changed: Mutex<bool>,
}

impl SourceDigests {
    /// Reads the cache; `rehash` starts with an empty one. An unreadable cache is an empty one.
    pub fn load(cache_file: &Path, rehash: bool) -> Self {
        let read = || serde_json::from_slice(&std::fs::read(cache_file).ok()?).ok();
        let rows = if rehash { None } else { read() };
        Self { rows: Mutex::new(rows.unwrap_or_default()), changed: Mutex::new(false) }
    }

    /// The cache's new contents, if they changed since it was loaded or last asked for.
    pub fn changed_cache(&self) -> serde_json::Result<Option<Vec<u8>>> {
        let changed = std::mem::take(&mut *lock(&self.changed));
        changed.then(|| serde_json::to_vec(&*lock(&self.rows))).transpose()
    }

    /// The digest of a file's contents, or of a folder's sorted relative paths and contents.
    pub fn digest(&self, path: &Path) -> Result<Digest, SourceError> {
        let files = files_below(path)?;
        let lines: Vec<String> = files
            .par_iter()
            .map(|(name, file)| Ok(format!("{} {name}\n", self.file_digest(file)?)))
            .collect::<Result<_, SourceError>>()?;
        Ok(Digest::of(lines.concat().as_bytes()))
    }

    /// What `stat` says about every file below `path`, as one digest: unequal means that something moved.
    pub fn stat_digest(path: &Path) -> Result<Digest, SourceError> {
        let files = files_below(path)?;
        let stats: Vec<(&str, Stat)> = files
            .iter()
            .map(|(name, file)| Ok((name.as_str(), Stat::of(file).map_err(|error| unreadable(file, error))?)))
            .collect::<Result<_, SourceError>>()?;
        let bytes = serde_json::to_vec(&stats).map_err(|error| unreadable(path, error.into()))?;
        Ok(Digest::of(&bytes))
    }

    /// The digest of one file, from the cache when its row can be trusted.
    fn file_digest(&self, path: &Path) -> Result<Digest, SourceError> {
        let stat = Stat::of(path).map_err(|error| unreadable(path, error))?;
        let known = lock(&self.rows).get(path).and_then(|row| row.digest_if(&stat));
        if let Some(sha256) = known {
            return Ok(sha256);
        }
        let hashed_at_ns = now_ns();
        let sha256 = Digest::of_file(path).map_err(|error| unreadable(path, error))?;
        lock(&self.rows).insert(path.to_owned(), Row { stat, sha256, hashed_at_ns });
        *lock(&self.changed) = true;
        Ok(sha256)
    }
}

/// All files below `path` (or `path` itself, named ""), with `/`-separated relative names, sorted by name.
/// Links are followed: a data set may well be spread over disks.
fn files_below(path: &Path) -> Result<Vec<(String, PathBuf)>, SourceError> {
    let meta = match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(SourceError::Missing(path.to_owned())),
        other => other.map_err(|error| unreadable(path, error))?,
    };
    if meta.is_file() {
        return Ok(vec![(String::new(), path.to_owned())]);
    }
    let mut files = Vec::new();
    for entry in WalkDir::new(path).follow_links(true) {
        let entry = entry.map_err(|error| unreadable(path, error.into()))?;
        if entry.file_type().is_file() {
            files.push((relative_name(path, entry.path())?, entry.into_path()));
        }
    }
    files.sort();
    Ok(files)
}

/// `path` relative to `root`, separated by `/`.
fn relative_name(root: &Path, path: &Path) -> Result<String, SourceError> {
    let relative = path.strip_prefix(root).unwrap_or(path);
    let parts: Option<Vec<&str>> = relative.iter().map(|part| part.to_str()).collect();
    Ok(parts.ok_or_else(|| SourceError::Name(path.to_owned()))?.join("/"))
}

fn unreadable(path: &Path, error: io::Error) -> SourceError {
    SourceError::Unreadable(path.to_owned(), error)
}

fn now_ns() -> i64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
