//! SHA-256 of files and folders.

use std::fmt::Write as _;
use std::path::Path;

use engine::Digest;
use walkdir::WalkDir;

use crate::error::{Result, io};

/// The hash of a text in hexadecimal digits.
pub(crate) fn of_text(text: &str) -> String {
    Digest::of(text.as_bytes()).to_string()
}

/// The hash of a file, or of the names and contents of all files in a folder; `None` if there is neither.
pub(crate) fn of_path(path: &Path) -> Result<Option<String>> {
    if path.is_file() {
        return of_file(path).map(|hash| Some(hash.to_string()));
    }
    if !path.is_dir() {
        return Ok(None);
    }
    let mut all = String::new();
    for entry in WalkDir::new(path).follow_links(true).sort_by_file_name() {
        let entry = entry.map_err(|error| io(&error.into(), path))?;
        if entry.file_type().is_file() {
            let name = entry.path().strip_prefix(path).unwrap_or(entry.path());
            let _ = writeln!(all, "{} {}", of_file(entry.path())?, name.display());
        }
    }
    Ok(Some(of_text(&all)))
}

fn of_file(path: &Path) -> Result<Digest> {
    Digest::of_file(path).map_err(|error| io(&error, path))
}
