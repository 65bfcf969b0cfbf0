//! SHA-256 of files and folders.

use std::io::Read as _;
use std::path::Path;

use sha2::{Digest as _, Sha256};
use walkdir::WalkDir;

use crate::error::{Result, io};

/// Bytes that are read at once.
const CHUNK: usize = 1 << 20;

/// The hash of a text in hexadecimal digits.
pub(crate) fn of_text(text: &str) -> String {
    hex(&Sha256::digest(text.as_bytes()))
}

/// The hash of a file, or of the names and contents of all files in a folder; `None` if there is neither.
pub(crate) fn of_path(path: &Path) -> Result<Option<String>> {
    if path.is_file() {
        return of_file(path).map(Some);
    }
    if !path.is_dir() {
        return Ok(None);
    }
    let mut all = Sha256::new();
    for entry in WalkDir::new(path).follow_links(true).sort_by_file_name() {
        let entry = entry.map_err(|error| io(&error.into(), path))?;
        if entry.file_type().is_file() {
            let name = entry.path().strip_prefix(path).unwrap_or(entry.path());
            all.update(format!("{} {}\n", of_file(entry.path())?, name.display()));
        }
    }
    Ok(Some(hex(&all.finalize())))
}

fn of_file(path: &Path) -> Result<String> {
    let mut file = std::fs::File::open(path).map_err(|error| io(&error, path))?;
    let (mut hash, mut chunk) = (Sha256::new(), vec![0; CHUNK]);
    loop {
        match file.read(&mut chunk).map_err(|error| io(&error, path))? {
            0 => return Ok(hex(&hash.finalize())),
            length => hash.update(&chunk[..length]),
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
