//! Folders with one file per view.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Capture, View};

use crate::Videos;

/// The files of one folder by the view that they belong to.
///
/// A file is called like its view (`train_000.npy`), or by its frame's number (`00042.exr`, with any number of zeros)
/// where every frame number names one view.
pub struct ViewFolder {
    dir: PathBuf,
    by_stem: BTreeMap<String, PathBuf>,
}

impl ViewFolder {
    /// The files in `dir` that end in one of `extensions`; `None` where there is no such folder.
    pub fn open(dir: &Path, extensions: &[&str]) -> anyhow::Result<Option<Self>> {
        if !dir.is_dir() {
            return Ok(None);
        }
        let mut by_stem: BTreeMap<String, PathBuf> = BTreeMap::new();
        let entries = std::fs::read_dir(dir)?.collect::<std::io::Result<Vec<_>>>()?;
        for path in entries.into_iter().map(|entry| entry.path()) {
            let extension =
                path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
            let Some(stem) = path.file_stem().and_then(|stem| stem.to_str()) else { continue };
            if !extensions.contains(&extension.as_str()) {
                continue;
            }
            if let Some(other) = by_stem.insert(canonical(stem), path.clone()) {
                let message = format!("two files for one view: {} and this", other.display());
                return Err(bad(message).hint("remove one of them").at(path).into());
            }
        }
        Ok(Some(Self { dir: dir.into(), by_stem }))
    }

    /// The file of a view.
    pub fn find(&self, view: &View, videos: &Videos) -> Option<&Path> {
        let by_number = || self.by_stem.get(&videos.number(view)?.to_string());
        self.by_stem.get(&canonical(&view.name)).or_else(by_number).map(PathBuf::as_path)
    }

    /// Files for the views of a capture in its order, and how many files belong to none. Every view that `needs` one
    /// must have one.
    pub fn of_views(
        &self,
        capture: &Capture,
        needs: impl Fn(&View) -> bool,
    ) -> anyhow::Result<(Vec<Option<&Path>>, usize)> {
        let videos = Videos::of(capture);
        let files: Vec<_> = capture.views.iter().map(|view| self.find(view, &videos)).collect();
        let missing: Vec<&str> = capture
            .views
            .iter()
            .zip(&files)
            .filter(|(view, file)| file.is_none() && needs(view))
            .map(|(view, _)| view.name.as_str())
            .collect();
        let found = files.iter().flatten().count();
        if let Some(first) = missing.first() {
            let message = format!("{} views have no file here, the first is {first}", missing.len());
            let number = videos.number(&capture.views[0]).map_or("", |_| ", or by the frame's number");
            let hint = format!("files are called like the views of the capture{number}");
            return Err(Failure::new(FailureKind::MissingData, message).hint(hint).at(&self.dir).into());
        }
        Ok((files, self.by_stem.len().saturating_sub(found)))
    }

    /// The folder itself.
    pub fn dir(&self) -> &Path {
        &self.dir
    }
}

/// Numbers with any count of leading zeros are one number.
fn canonical(stem: &str) -> String {
    stem.parse::<u32>().map_or_else(|_| stem.to_owned(), |number| number.to_string())
}

/// Bad input with a message.
pub(crate) fn bad(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::BadInput, message)
}
