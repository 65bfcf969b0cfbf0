//! Folders with one file per view, named by view or by frame number.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Capture, Error, Result, Videos};

/// What the names of files refer to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Naming {
    /// Names of views or frame numbers, whichever fit. It is an error if both fit some file and disagree, unless every
    /// file has exactly the name of a view, and every view a file.
    #[default]
    Auto,
    /// Names of views (`train_000.npy`).
    Views,
    /// Frame numbers from 0 (`00042.exr`, with any number of leading zeros), if each identifies one view.
    Frames,
}

/// The files of one folder, indexed by the view that they belong to.
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

    /// The only file, after its name without leading zeros and ending; none if there are more.
    pub fn only_file(&self) -> Option<(&str, &Path)> {
        let (stem, path) = self.by_stem.first_key_value().filter(|_| self.by_stem.len() == 1)?;
        Some((stem, path))
    }

    /// Finds the file of every view of `capture`. An error if `naming` leaves open which file belongs to which view.
    pub fn match_views(&self, capture: &Capture, naming: Naming) -> Result<MatchedFiles<'_>> {
        let chosen = matched_names(&self.by_stem, capture, naming).map_err(|error| error.at(&self.dir))?;
        let files: Vec<_> = chosen.into_iter().map(|stem| Some(self.by_stem[&stem?].as_path())).collect();
        let found = files.iter().flatten().count();
        Ok(MatchedFiles { files, unused: self.by_stem.len() - found })
    }
}

/// The key in `files` of the file of every view of `capture`; keys are stems as [`canonical`] writes them. An error if
/// `naming` leaves open which file belongs to which view.
pub fn matched_names<F>(files: &BTreeMap<String, F>, capture: &Capture, naming: Naming) -> Result<Vec<Option<String>>> {
    let videos = Videos::of(capture);
    let existing = |stem: String| files.contains_key(&stem).then_some(stem);
    let by_name: Vec<_> = capture.views.iter().map(|view| existing(canonical(&view.name))).collect();
    let number = |view| existing(videos.number(view)?.to_string());
    let by_number: Vec<_> = capture.views.iter().map(number).collect();
    let is_exact = files.len() == by_name.len() && by_name.iter().all(Option::is_some);
    match naming {
        Naming::Views => Ok(by_name),
        Naming::Frames => Ok(by_number),
        Naming::Auto if is_exact => Ok(by_name),
        Naming::Auto => match conflict(&by_name, &by_number) {
            Some(at) => Err(ambiguous(capture, at, &by_name, &by_number)),
            None => Ok(by_name.into_iter().zip(by_number).map(|(name, number)| name.or(number)).collect()),
        },
    }
}

/// The first view with different files by name and by number, or whose file is that of another view by the other rule.
fn conflict(by_name: &[Option<String>], by_number: &[Option<String>]) -> Option<usize> {
    let numbered: BTreeMap<&String, usize> =
        by_number.iter().enumerate().filter_map(|(at, stem)| Some((stem.as_ref()?, at))).collect();
    by_name.iter().zip(by_number).enumerate().find_map(|(at, (name, number))| {
        let name = name.as_ref()?;
        let has_two = number.as_ref().is_some_and(|number| number != name);
        let is_of_another = numbered.get(name).is_some_and(|other| *other != at);
        (has_two || is_of_another).then_some(at)
    })
}

fn ambiguous(capture: &Capture, at: usize, by_name: &[Option<String>], by_number: &[Option<String>]) -> Error {
    let count = |stems: &[Option<String>]| stems.iter().flatten().count();
    let shown = |stem: &Option<String>| stem.as_ref().map_or("no file".into(), |stem| format!("file {stem}"));
    let message = format!(
        "the numbers of these files fit the views in two ways: as names of views ({} of {} views have a file) and as \
         frame numbers from 0 ({} of {}); e.g. view {} has {} by its name and {} by its frame number",
        count(by_name),
        capture.views.len(),
        count(by_number),
        capture.views.len(),
        capture.views[at].name,
        shown(&by_name[at]),
        shown(&by_number[at]),
    );
    let hint = "say which: naming = \"views\" or naming = \"frames\"; or rename the files exactly like the views";
    Error::new(message).hint(hint)
}

/// A stem without the leading zeros of a number.
pub fn canonical(stem: &str) -> String {
    stem.parse::<u32>().map_or_else(|_| stem.to_owned(), |number| number.to_string())
}
