//! The entries of a folder.

use std::io::Read;
use std::path::Path;

use crate::files::children;

/// Bytes of a file that are searched for its format: the first keys of every JSON, XML and CSV file known here.
const HEAD_BYTES: u64 = 4096;

/// The sorted names of the entries of a folder.
pub(super) struct Listing<'a> {
    pub(super) dir: &'a Path,
    pub(super) names: Vec<String>,
}

impl<'a> Listing<'a> {
    pub(super) fn of(dir: &'a Path) -> Self {
        Self::of_names(dir, children(dir))
    }

    pub(super) fn of_names(dir: &'a Path, names: Vec<String>) -> Self {
        Self { dir, names }
    }

    /// Whether there is an entry of this name.
    pub(super) fn has(&self, name: &str) -> bool {
        self.names.iter().any(|entry| entry == name)
    }

    /// Whether there is an entry of one of these names.
    pub(super) fn has_any(&self, names: &[&str]) -> bool {
        names.iter().any(|name| self.has(name))
    }

    /// The entries with one of these extensions, in lower case.
    pub(super) fn with_extension(&self, extensions: &[&str]) -> Vec<&str> {
        let matches = |name: &&str| {
            let extension = Path::new(name).extension().map(|extension| extension.to_string_lossy().to_lowercase());
            extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
        };
        self.names.iter().map(String::as_str).filter(matches).collect()
    }

    /// Whether there is an entry whose name ends in `end`.
    pub(super) fn has_end(&self, end: &str) -> bool {
        self.names.iter().any(|name| name.ends_with(end))
    }

    /// Whether the folder `folder` has an entry whose name ends in `end`.
    pub(super) fn has_within(&self, folder: &str, end: &str) -> bool {
        children(&self.dir.join(folder)).iter().any(|name| name.ends_with(end))
    }

    /// The first entry with this extension whose beginning contains one of `marks`.
    pub(super) fn marked(&self, extension: &str, marks: &[&str]) -> Option<&str> {
        let is_marked = |name: &&str| {
            let head = self.head(name);
            marks.iter().any(|mark| head.contains(mark))
        };
        self.with_extension(&[extension]).into_iter().find(is_marked)
    }

    /// The beginning of a file as text; empty if it cannot be read.
    pub(super) fn head(&self, name: &str) -> String {
        let mut bytes = Vec::new();
        let file = std::fs::File::open(self.dir.join(name));
        match file.and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut bytes)) {
            Ok(_) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(_) => String::new(),
        }
    }
}
