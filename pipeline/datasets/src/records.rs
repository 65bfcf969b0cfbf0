//! Records of fetches: addresses, hashes and files, in `.downloads/records.json` below the data root.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::Failure;
use serde::{Deserialize, Serialize};

use crate::files::{io, world};

/// A finished download.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// Its address.
    pub url: String,
    /// Its size in bytes, when it was last downloaded.
    pub size: u64,
    /// Its SHA-256 then, as hex digits.
    pub sha256: String,
    /// Whether the manifest stated the whole hash before.
    pub was_known: bool,
    /// Size and SHA-256 of every file that came out of it, by its path below the data root.
    pub files: BTreeMap<PathBuf, (u64, String)>,
}

/// The folder of unfinished downloads and of the records.
pub(crate) fn folder(data_root: &Path) -> PathBuf {
    data_root.join(".downloads")
}

fn path(data_root: &Path) -> PathBuf {
    folder(data_root).join("records.json")
}

/// All records; none if nothing was fetched.
pub(crate) fn read(data_root: &Path) -> Result<Vec<Record>, Failure> {
    let path = path(data_root);
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let text = fs_err::read(&path).map_err(io)?;
    let damaged =
        |error| world(format!("damaged records ({error})")).hint("remove the file, and fetch again").at(&path);
    serde_json::from_slice(&text).map_err(damaged)
}

/// Adds a record, with the files of earlier ones of the same address. Files below `replaced` (relative to the data root)
/// belong to the new record alone. The file is replaced by one rename, under a lock: other fetches may add theirs.
pub(crate) fn add(data_root: &Path, mut record: Record, replaced: &[PathBuf]) -> Result<(), Failure> {
    let lock_path = folder(data_root).join("records.lock");
    let lock = engine::lock::open(&lock_path).map_err(|error| io(error).at(&lock_path))?;
    lock.lock().or_else(engine::lock::if_supported).map_err(|error| io(error).at(&lock_path))?;
    let mut records = read(data_root)?;
    for other in &mut records {
        other.files.retain(|path, _| !replaced.iter().any(|folder| path.starts_with(folder)));
        if other.url == record.url {
            record.files.append(&mut other.files);
        }
    }
    records.retain(|other| !other.files.is_empty());
    records.push(record);
    let text = serde_json::to_vec_pretty(&records).map_err(|error| world(error.to_string()))?;
    let (path, new) = (path(data_root), folder(data_root).join("records.json.new"));
    fs_err::write(&new, text).map_err(io)?;
    fs_err::rename(new, path).map_err(io)
}
