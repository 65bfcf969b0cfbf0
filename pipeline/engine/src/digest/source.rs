//! Digests of sources (files and folders outside the store), with a cache of file digests keyed by `stat`.

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

/// A row of the cache is not trusted if the file changed less than this before it was hashed: the file may change again
/// without a new time stamp, because file systems have time stamps as coarse as 2 s.
const RACY_NANOS: i128 = 2_000_000_000;

/// The reason why a source has no digest.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The source does not exist.
    #[error("no such file or folder: {}", .0.display())]
    Missing(PathBuf),
    /// The source cannot be read.
    #[error("cannot read {}: {}", .0.display(), .1)]
    Unreadable(PathBuf, io::Error),
    /// A link in the source leads to nothing or to a folder that contains it.
    #[error("the link leads nowhere or in a circle: {}", .0.display())]
    Link(PathBuf),
    /// A file name is not UTF-8, so it has no portable digest.
    #[error("file name is not UTF-8: {}", .0.display())]
    Name(PathBuf),
}

/// The result of `stat` for a file. Equal results mean that the file is unchanged.
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

/// One row of the cache: a file's digest, and its `stat` when it was hashed.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    stat: Stat,
    sha256: Digest,
    hashed_at_ns: i64,
}

impl Row {
    /// The digest, if the file has the same `stat` and was last changed well before it was hashed.
    fn digest_if(&self, stat: &Stat) -> Option<Digest> {
        let newest_ns = i128::from(stat.mtime_ns.max(stat.ctime_ns));
        let is_old = newest_ns + RACY_NANOS < i128::from(self.hashed_at_ns);
        (self.stat == *stat && is_old).then_some(self.sha256)
    }
}

/// Digests of the sources below one data root. A JSON file caches the file digests between runs.
pub struct SourceDigests {
    rows: Mutex<BTreeMap<PathBuf, Row>>,
    changed: Mutex<bool>,
}

impl SourceDigests {
    /// Reads the cache. `rehash` ignores it; an unreadable cache counts as empty.
    pub fn load(cache_file: &Path, rehash: bool) -> Self {
        let read = || serde_json::from_slice(&std::fs::read(cache_file).ok()?).ok();
        let rows = if rehash { None } else { read() };
        Self { rows: Mutex::new(rows.unwrap_or_default()), changed: Mutex::new(false) }
    }

    /// The cache's contents, if they changed since it was loaded or since the last call.
    pub fn changed_cache(&self) -> serde_json::Result<Option<Vec<u8>>> {
        let changed = std::mem::take(&mut *lock(&self.changed));
        changed.then(|| serde_json::to_vec(&*lock(&self.rows))).transpose()
    }

    /// The digest of a file's contents, or of the sorted relative paths and contents of a folder's files.
    pub fn digest(&self, path: &Path) -> Result<Digest, SourceError> {
        let files = files_below(path)?;
        let lines: Vec<String> = files
            .par_iter()
            .map(|(name, file)| Ok(format!("{} {name}\n", self.file_digest(file)?)))
            .collect::<Result<_, SourceError>>()?;
        Ok(Digest::of(lines.concat().as_bytes()))
    }

    /// One digest of the `stat` results of all files below `path`. It changes when any file changes.
    pub fn stat_digest(path: &Path) -> Result<Digest, SourceError> {
        let files = files_below(path)?;
        let stats: Vec<(&str, Stat)> = files
            .iter()
            .map(|(name, file)| Ok((name.as_str(), Stat::of(file).map_err(|error| unreadable(file, error))?)))
            .collect::<Result<_, SourceError>>()?;
        let bytes = serde_json::to_vec(&stats).map_err(|error| unreadable(path, error.into()))?;
        Ok(Digest::of(&bytes))
    }

    /// The digest of one file, from the cache if its row can be trusted.
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
/// Follows links, because a data set may be spread over several disks.
fn files_below(path: &Path) -> Result<Vec<(String, PathBuf)>, SourceError> {
    let meta = match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(SourceError::Missing(path.to_owned())),
        Err(error) if is_link_to_itself(&error) => return Err(SourceError::Link(path.to_owned())),
        other => other.map_err(|error| unreadable(path, error))?,
    };
    if meta.is_file() {
        return Ok(vec![(String::new(), path.to_owned())]);
    }
    if !meta.is_dir() {
        let error = io::Error::new(io::ErrorKind::InvalidInput, "neither a file nor a folder");
        return Err(unreadable(path, error));
    }
    let mut files = Vec::new();
    for entry in WalkDir::new(path).follow_links(true) {
        let entry = entry.map_err(|error| of_entry(path, error))?;
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

/// The error for a file or folder below `root`.
fn of_entry(root: &Path, error: walkdir::Error) -> SourceError {
    let path = error.path().unwrap_or(root).to_owned();
    let is_circle = error.loop_ancestor().is_some() || error.io_error().is_some_and(is_link_to_itself);
    let is_dangling =
        error.io_error().is_some_and(|error| error.kind() == io::ErrorKind::NotFound) && path.is_symlink();
    if is_circle || is_dangling { SourceError::Link(path) } else { unreadable(&path, error.into()) }
}

fn is_link_to_itself(error: &io::Error) -> bool {
    error.raw_os_error() == Some(libc::ELOOP)
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
