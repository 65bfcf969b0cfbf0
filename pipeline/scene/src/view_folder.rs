//! Folders with one file per view, named by view or by frame number.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::{Capture, Error, Result, Videos, View};

/// The files of one folder, indexed by the view that they belong to.
///
/// A file has the name of its view (`train_000.npy`). If every frame number identifies one view, the frame number works
/// too (`00042.exr`, with any number of leading zeros).
pub struct ViewFolder {
    dir: PathBuf,
    by_stem: BTreeMap<String, PathBuf>,
}

/// The files of a folder, matched with the views of a capture.
pub struct MatchedFiles<'a> {
    /// One entry per view of the capture, in its order; `None` for views without a file.
    pub files: Vec<Option<&'a Path>>,
    /// Number of files that belong to no view.
    pub unused: usize,
}

impl ViewFolder {
    /// Lists the files in `dir` with one of `extensions` (lower case); `None` if the folder does not exist. Two files
    /// for one view are an error.
    pub fn open(dir: &Path, extensions: &[&str]) -> Result<Option<Self>> {
        if !dir.is_dir() {
            return Ok(None);
        }
        let mut by_stem: BTreeMap<String, PathBuf> = BTreeMap::new();
        let entries = std::fs::read_dir(dir).and_then(Iterator::collect::<std::io::Result<Vec<_>>>);
        let entries = entries.map_err(|error| Error::new("cannot list the folder").at(dir).because_of(error))?;
        for path in entries.into_iter().map(|entry| entry.path()) {
            let extension =
                path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
            let Some(stem) = path.file_stem().and_then(|stem| stem.to_str()) else { continue };
            if !extensions.contains(&extension.as_str()) {
                continue;
            }
            if let Some(other) = by_stem.insert(canonical(stem), path.clone()) {
                let message = format!("two files for one view: {} and this one", other.display());
                return Err(Error::new(message).hint("remove one of them").at(path));
            }
        }
        Ok(Some(Self { dir: dir.into(), by_stem }))
    }

    /// The folder itself.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Finds the file of every view of `capture`.
    pub fn match_views(&self, capture: &Capture) -> MatchedFiles<'_> {
        let videos = Videos::of(capture);
        let files: Vec<_> = capture.views.iter().map(|view| self.find(view, &videos)).collect();
        let found = files.iter().flatten().count();
        MatchedFiles { files, unused: self.by_stem.len().saturating_sub(found) }
    }

    /// The file of one view.
    fn find(&self, view: &View, videos: &Videos) -> Option<&Path> {
        let by_number = || self.by_stem.get(&videos.number(view)?.to_string());
        self.by_stem.get(&canonical(&view.name)).or_else(by_number).map(PathBuf::as_path)
    }
}

/// Drops the leading zeros of numbers.
fn canonical(stem: &str) -> String {
    stem.parse::<u32>().map_or_else(|_| stem.to_owned(), |number| number.to_string())
}
