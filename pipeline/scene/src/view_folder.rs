//! Folders with one file per view, named by view or by frame number.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Capture, Error, Result, Videos};

/// The meaning of file names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Naming {
    /// Names of views or frame numbers, whichever fit. It is an error if both fit some file and disagree, unless every
    /// file has exactly the name of a view, and every view a file. It is also an error if the first frame has no
    /// file and others have theirs by number.
    #[default]
    Auto,
    /// Names of views (`train_000.npy`).
    Views,
    /// Frame numbers from 0 (`00042.exr` or `frame_00042.exr`, with any number of leading zeros), if each identifies one
    /// view.
    Frames,
    /// Frame numbers from 1.
    FramesFromOne,
}

/// Extensions of files that hold values as they are.
const VALUES: [&str; 4] = ["exr", "npy", "npz", "pfm"];
/// Extensions of images that may be part of the name of a map: COLMAP names the mask of `a.jpg` `a.jpg.png`.
const IMAGE_EXTENSIONS: [&str; 6] = [".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff"];

/// The files of one folder, indexed by the view that they belong to.
pub struct ViewFolder {
    dir: PathBuf,
    by_stem: BTreeMap<String, PathBuf>,
    names_images: bool,
}

/// The files of a folder, matched with the views of a capture.
pub struct MatchedFiles<'a> {
    /// One entry per view of the capture, in its order; `None` for views without a file.
    pub files: Vec<Option<&'a Path>>,
    /// Number of files that belong to no view.
    pub unused: usize,
}

impl ViewFolder {
    /// Lists the files in `dir` with one of `extensions` (lower case), without hidden files, e.g. those that macOS adds to
    /// archives; `None` if the folder does not exist. Two files
    /// for one view are an error, except that a PNG file yields to values, and all PNG files to flow in `.flo` files.
    pub fn open(dir: &Path, extensions: &[&str]) -> Result<Option<Self>> {
        if !dir.is_dir() {
            return Ok(None);
        }
        let mut by_stem: BTreeMap<String, PathBuf> = BTreeMap::new();
        let mut names_images = false;
        let entries = std::fs::read_dir(dir).and_then(Iterator::collect::<std::io::Result<Vec<_>>>);
        let entries = entries.map_err(|error| Error::new("cannot list the folder").at(dir).because_of(error))?;
        let paths: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
        let is_flow = extensions.contains(&"flo") && paths.iter().any(|path| extension(path) == "flo");
        for path in paths {
            let Some(stem) = path.file_stem().and_then(|stem| stem.to_str()) else { continue };
            let own = extension(&path);
            // Pictures of the flow in the same folder.
            if !extensions.contains(&own.as_str()) || is_flow && own == "png" || stem.starts_with('.') {
                continue;
            }
            let bare = without_image_extension(stem);
            names_images |= bare != stem;
            let Some(other) = by_stem.insert(canonical(bare), path.clone()) else { continue };
            // MiDaS writes a PNG file with fewer bits next to the values.
            match (extension(&other).as_str(), own.as_str()) {
                ("png", own) if VALUES.contains(&own) => (),
                (other_extension, "png") if VALUES.contains(&other_extension) => {
                    by_stem.insert(canonical(bare), other);
                }
                _ => {
                    let message = format!("two files for one view: {} and this one", other.display());
                    return Err(Error::new(message).hint("remove one of them").at(path));
                }
            }
        }
        Ok(Some(Self { dir: dir.into(), by_stem, names_images }))
    }

    /// The folder itself.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Whether it has no file.
    pub fn is_empty(&self) -> bool {
        self.by_stem.is_empty()
    }

    /// Whether files are named like images with their extension, e.g. `a.jpg.png`, as COLMAP's masks are.
    pub fn names_images(&self) -> bool {
        self.names_images
    }

    /// The only file, after its name without leading zeros and ending; none if there are more.
    pub fn only_file(&self) -> Option<(&str, &Path)> {
        let (stem, path) = self.by_stem.first_key_value().filter(|_| self.by_stem.len() == 1)?;
        Some((stem, path))
    }

    /// Finds the file of every view of `capture`. An error if `naming` does not decide which file belongs to which view.
    pub fn match_views(&self, capture: &Capture, naming: Naming) -> Result<MatchedFiles<'_>> {
        let chosen = matched_names(&self.by_stem, capture, naming).map_err(|error| error.at(&self.dir))?;
        let files: Vec<_> = chosen.into_iter().map(|stem| Some(self.by_stem[&stem?].as_path())).collect();
        let found = files.iter().flatten().count();
        Ok(MatchedFiles { files, unused: self.by_stem.len() - found })
    }
}

/// The key in `files` of the file of every view of `capture`; keys are stems as [`canonical`] writes them. An error if
/// `naming` does not decide which file belongs to which view.
pub fn matched_names<F>(files: &BTreeMap<String, F>, capture: &Capture, naming: Naming) -> Result<Vec<Option<String>>> {
    let names = bare_names(files.keys(), capture);
    let chosen = chosen_names(&names, capture, naming)?;
    Ok(chosen.into_iter().map(|name| Some(names[&name?].clone())).collect())
}

/// The names of files without a common suffix that begins with `_` or `-`, which estimators append (`00001_pred`), and
/// the names with it. If any name is that of a view, the names are unchanged.
fn bare_names<'f>(stems: impl Iterator<Item = &'f String> + Clone, capture: &Capture) -> BTreeMap<String, String> {
    let whole: BTreeMap<String, String> = stems.clone().map(|stem| (stem.clone(), stem.clone())).collect();
    let is_view = |stem: &String| capture.views.iter().any(|view| canonical(&view.name) == *stem);
    if whole.len() < 2 || whole.keys().any(is_view) {
        return whole;
    }
    let common = stems.clone().map(String::as_str).reduce(common_end).unwrap_or_default();
    let Some(start) = common.find(['_', '-']) else { return whole };
    let without = |stem: &String| canonical(&stem[..stem.len() - (common.len() - start)]);
    let bare: BTreeMap<String, String> = stems.map(|stem| (without(stem), stem.clone())).collect();
    if bare.len() == whole.len() { bare } else { whole }
}

/// The longest common suffix of two names.
fn common_end<'a>(a: &'a str, b: &str) -> &'a str {
    let equal = a.char_indices().rev().zip(b.chars().rev()).take_while(|((_, a), b)| a == b);
    equal.last().map_or("", |((at, _), _)| &a[at..])
}

/// The name in `files` of the file of every view.
fn chosen_names(files: &BTreeMap<String, String>, capture: &Capture, naming: Naming) -> Result<Vec<Option<String>>> {
    let videos = Videos::of(capture);
    let by_name: Vec<_> = capture.views.iter().map(|view| Some(canonical(&view.name))).collect();
    let by_name: Vec<_> = by_name.into_iter().map(|stem| stem.filter(|stem| files.contains_key(stem))).collect();
    let numbered = numbered(files, &by_name);
    let from = |first: u32| -> Vec<Option<String>> {
        let number = |view| numbered.get(&(videos.number(view)? + first)).map(|stem| (*stem).clone());
        capture.views.iter().map(number).collect()
    };
    let is_exact = files.len() == by_name.len() && by_name.iter().all(Option::is_some);
    match naming {
        Naming::Views => Ok(by_name),
        Naming::Frames => Ok(from(0)),
        Naming::FramesFromOne => Ok(from(1)),
        Naming::Auto if is_exact => Ok(by_name),
        Naming::Auto => {
            let by_number = from(0);
            if let Some(at) = conflict(&by_name, &by_number) {
                return Err(ambiguous(capture, at, &by_name, &by_number));
            }
            let last = capture.views.iter().filter_map(|view| videos.number(view)).max();
            let has_end = last.is_some_and(|last| numbered.contains_key(&(last + 1)));
            // Flow has no file for the last frame, so that numbers from 1 also fit frames from 0 if the first is held out.
            let lacks_start = || {
                let mut named = capture.views.iter().zip(&by_name);
                named.any(|(view, name)| videos.number(view) == Some(0) && name.is_none())
            };
            let has_numbers = !numbered.contains_key(&0) && by_number.iter().any(Option::is_some);
            if has_numbers && (has_end || lacks_start()) {
                return Err(without_zero(numbered.len()));
            }
            Ok(by_name.into_iter().zip(by_number).map(|(name, number)| name.or(number)).collect())
        }
    }
}

/// The names of files by the number in them: the name itself or, if all names are one prefix and a number and some belong to no
/// view, the number after the prefix.
fn numbered<'f, F>(files: &'f BTreeMap<String, F>, by_name: &[Option<String>]) -> BTreeMap<u32, &'f String> {
    let plain: BTreeMap<u32, &String> = files.keys().filter_map(|stem| Some((stem.parse().ok()?, stem))).collect();
    let prefix = |stem: &'f String| stem.trim_end_matches(|symbol: char| symbol.is_ascii_digit());
    let prefixes: BTreeSet<&str> = files.keys().map(prefix).collect();
    let all_named = files.len() == by_name.iter().flatten().collect::<BTreeSet<_>>().len();
    let Some(prefix) = prefixes.first().filter(|_| plain.is_empty() && prefixes.len() == 1 && !all_named) else {
        return plain;
    };
    files.keys().filter_map(|stem| Some((stem[prefix.len()..].parse().ok()?, stem))).collect()
}

/// The error for numbered files without the number 0.
fn without_zero(count: usize) -> Error {
    let message =
        format!("the numbers of these {count} files do not start at 0, so the first frame may have the number 0 or 1");
    let hint = "set naming = \"frames-from-one\" if it has the number 1, or naming = \"frames\" if it has the number 0 and no file, \
                e.g. because it is held out";
    Error::new(message).hint(hint)
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
    let hint = "say which: naming = \"views\", naming = \"frames\" or naming = \"frames-from-one\"; or rename the files exactly \
                like the views";
    Error::new(message).hint(hint)
}

/// A stem without the leading zeros of a number.
pub fn canonical(stem: &str) -> String {
    stem.parse::<u32>().map_or_else(|_| stem.to_owned(), |number| number.to_string())
}

/// The extension of a path in lower case; empty without one.
fn extension(path: &Path) -> String {
    path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase()
}

/// A stem without the extension of an image at its end.
fn without_image_extension(stem: &str) -> &str {
    let lower = stem.to_ascii_lowercase();
    let extension = IMAGE_EXTENSIONS.iter().find(|extension| lower.ends_with(**extension));
    extension.map_or(stem, |extension| &stem[..stem.len() - extension.len()])
}
