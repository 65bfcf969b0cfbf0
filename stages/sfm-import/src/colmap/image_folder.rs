//! The folder of a model's images: the originals, or a smaller copy of them (`images_2`, `images_4`, `images_8`, …).
//!
//! A smaller copy is used only if it has every registered image, at the model's size divided by the number in its name.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::colmap::model::Model;
use crate::companion_files::is_companion_folder;
use crate::error::{Result, bad};
use crate::files::{children, image_size};
use crate::image_names::{EXTENSIONS, image_names, images_dir};
use crate::lens::Lens;
use crate::params::Params;

/// Endings of the names of masks and depth maps.
const COMPANIONS: [&str; 2] = ["_mask", "_depth"];

/// The chosen folder and the lenses for its images.
pub(super) struct ImageFolder {
    /// The folder that image names are relative to.
    pub(super) path: PathBuf,
    /// The factor by which its images are smaller than in the model.
    pub(super) reduction: u32,
    /// The lenses of the model at the size of these images, by camera id.
    pub(super) lenses: BTreeMap<u32, Lens>,
    /// The reasons why other folders are not used.
    pub(super) warnings: Vec<String>,
}

impl ImageFolder {
    /// The folder that `params.images` names. Otherwise the smallest copy of at least `params.width`, the originals in
    /// `images` or `dir`, the largest copy, or any other folder with all images at the model's size, except
    /// folders of masks and maps.
    pub(super) fn choose(dir: &Path, model: &Model, params: &Params) -> Result<Self> {
        let original = images_dir(dir);
        let mut warnings = Vec::new();
        let mut chosen = match &params.images {
            Some(name) => Self::named(dir, name, model)?,
            None => {
                let has_originals = has_any(&original, model);
                let wants_copy = params.width.is_some() || !has_originals;
                let mut copies = if wants_copy { copies(dir, model, &mut warnings) } else { Vec::new() };
                let is_wide = |copy: &Self| params.width.is_some_and(|width| copy.smallest_width() >= width);
                match copies.iter().rposition(is_wide) {
                    Some(at) => copies.swap_remove(at),
                    None if has_originals => Self::originals(original, model),
                    None if !copies.is_empty() => copies.swap_remove(0),
                    None => Self::elsewhere(dir, model).unwrap_or(Self::originals(original, model)),
                }
            }
        };
        if !has_any(&chosen.path, model) {
            if let Some(failure) = other_names(&chosen.path, model) {
                return Err(failure);
            }
            if params.images.is_none() {
                chosen.path = dir.join("images"); // where they are expected
                warnings.extend(not_photos(dir));
            }
        }
        let is_usual = [images_dir(dir), dir.join("images")].contains(&chosen.path);
        let from = chosen.path.strip_prefix(dir).unwrap_or(&chosen.path).display();
        match chosen.reduction {
            1 if is_usual || params.images.is_some() => (),
            1 => warnings.push(format!("images are read from {from}")),
            reduction => warnings.push(format!("images are read from {from}, at 1/{reduction} of the model's size")),
        }
        Ok(Self { warnings, ..chosen })
    }

    /// The folder that the parameters name, with the reduction of its images.
    fn named(dir: &Path, name: &Path, model: &Model) -> Result<Self> {
        let path = dir.join(name);
        if !path.is_dir() {
            let hint = format!("images names a folder of the capture; found {}", folders(dir).join(", "));
            let failure = Failure::new(FailureKind::MissingData, "no such folder of images");
            return Err(failure.hint(hint).at(path));
        }
        let stated = number(&name.to_string_lossy());
        let copy = stated.and_then(|reduction| Self::reduced(path.clone(), reduction, model).ok());
        Ok(copy.unwrap_or_else(|| Self::originals(path, model)))
    }

    /// The first sub-folder with all images at the model's size. Masks and maps have the same names and sizes.
    fn elsewhere(dir: &Path, model: &Model) -> Option<Self> {
        let mut photos = folders(dir).into_iter().filter(|name| !name.starts_with('.') && !is_companion_folder(name));
        photos.find_map(|name| Self::reduced(dir.join(name), 1, model).ok())
    }

    /// A folder of images at the model's size, which [`crate::source::SourceCapture::problems`] checks.
    fn originals(path: PathBuf, model: &Model) -> Self {
        Self { path, reduction: 1, lenses: model.cameras.clone(), warnings: Vec::new() }
    }

    /// A folder with all images of the model at 1/`reduction` of its size, or why it is not one.
    fn reduced(path: PathBuf, reduction: u32, model: &Model) -> std::result::Result<Self, String> {
        let mut lenses = BTreeMap::new();
        for image in model.images.values() {
            let file = stored(&path, &image.name).ok_or_else(|| format!("{} is missing", image.name))?;
            if lenses.contains_key(&image.camera_id) {
                continue;
            }
            let lens = model.cameras[&image.camera_id];
            let (width, height) = image_size(&file).map_err(|failure| failure.to_string())?;
            let full = (lens.intrinsics.width, lens.intrinsics.height);
            if !is_reduced(full.0, width, reduction) || !is_reduced(full.1, height, reduction) {
                let (w, h) = full;
                return Err(format!("{} is {width}×{height}, not 1/{reduction} of {w}×{h}", image.name));
            }
            lenses.insert(image.camera_id, lens.resized(width, height));
        }
        Ok(Self { path, reduction, lenses, warnings: Vec::new() })
    }

    fn smallest_width(&self) -> u32 {
        self.lenses.values().map(|lens| lens.intrinsics.width).min().unwrap_or_default()
    }

    /// The file of an image; a missing file has the name that the model states.
    pub(super) fn file(&self, name: &str) -> Result<PathBuf> {
        let path = inside(name)?;
        Ok(stored(&self.path, name).unwrap_or_else(|| self.path.join(path)))
    }

    /// The names of all images in the folder; those of registered images as the model spells them. Files next to a
    /// registered image that have its name with another extension, `_mask` or `_depth` are not further frames.
    pub(super) fn names(&self, model: &Model) -> Vec<String> {
        let names = model.images.values().map(|image| image.name.as_str());
        let registered: BTreeMap<PathBuf, &str> =
            names.map(|name| (Path::new(name).with_extension(""), name)).collect();
        let is_companion = |stem: &str| {
            let mut images = COMPANIONS.iter().filter_map(|ending| stem.strip_suffix(ending));
            images.any(|image| registered.contains_key(Path::new(image)))
        };
        let spelled = |name: String| {
            let stem = Path::new(&name).with_extension("");
            match registered.get(&stem) {
                Some(stated) => Some((*stated).to_owned()),
                None if is_companion(&stem.to_string_lossy()) => None,
                None => Some(name),
            }
        };
        let mut seen = BTreeSet::new();
        image_names(&self.path).into_iter().filter_map(spelled).filter(|name| seen.insert(name.clone())).collect()
    }
}

/// Whether `side` is 1/`reduction` of `full`, rounded down, to the nearest or up.
pub(super) fn is_reduced(full: u32, side: u32, reduction: u32) -> bool {
    (full / reduction..=full.div_ceil(reduction)).contains(&side)
}

/// The usable folders `images_N`, largest images first; the others are named in `warnings`.
fn copies(dir: &Path, model: &Model, warnings: &mut Vec<String>) -> Vec<ImageFolder> {
    let mut numbered: Vec<(u32, String)> =
        children(dir).into_iter().filter_map(|name| Some((number(&name)?, name))).collect();
    numbered.sort();
    let mut copies = Vec::new();
    for (reduction, name) in numbered.into_iter().filter(|(_, name)| dir.join(name).is_dir()) {
        match ImageFolder::reduced(dir.join(&name), reduction, model) {
            Ok(copy) => copies.push(copy),
            Err(why) => warnings.push(format!("{name} is not used: {why}")),
        }
    }
    copies
}

/// The reduction in a folder's name, e.g. 4 of `images_4`.
fn number(name: &str) -> Option<u32> {
    name.strip_prefix("images_")?.parse().ok().filter(|number| *number > 1)
}

/// The file of an image in a folder: of that name, or with the extension of a copy.
fn stored(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(inside(name).ok()?);
    let copies = EXTENSIONS.iter().flat_map(|extension| [(*extension).to_owned(), extension.to_uppercase()]);
    let copies: Vec<PathBuf> = copies.map(|extension| path.with_extension(extension)).collect();
    std::iter::once(path).chain(copies).find(|path| path.is_file())
}

fn has_any(folder: &Path, model: &Model) -> bool {
    model.images.values().any(|image| stored(folder, &image.name).is_some() || inside(&image.name).is_err())
}

/// The error for a folder with images of other names than the model's.
fn other_names(folder: &Path, model: &Model) -> Option<Failure> {
    let is_photo = |name: &String| !name.split('/').rev().skip(1).any(is_companion_folder);
    let other = image_names(folder).into_iter().find(is_photo)?;
    let first = model.images.values().next().map_or("", |image| &image.name);
    let message = format!("image file is missing: no image of the model is in this folder, e.g. {first}");
    let hint =
        format!("the images must have the names that structure from motion used; this folder has {other} instead");
    Some(Failure::new(FailureKind::MissingData, message).hint(hint).at(folder))
}

/// A warning about the folders that [`ImageFolder::elsewhere`] leaves out.
fn not_photos(dir: &Path) -> Option<String> {
    let left_out: Vec<String> = folders(dir).into_iter().filter(|name| is_companion_folder(name)).collect();
    let names = left_out.join(", ");
    (!left_out.is_empty())
        .then(|| format!("not read as images, because their names are those of masks or maps: {names}"))
}

/// The sub-folders of the capture.
fn folders(dir: &Path) -> Vec<String> {
    children(dir).into_iter().filter(|name| dir.join(name).is_dir()).collect()
}

/// Removes a folder that all image names begin with, if the images are in `images` (or in `dir`) without it: some
/// exporters state the paths of their machine. Returns a warning. Backslashes become slashes.
pub(super) fn drop_foreign_folder(dir: &Path, model: &mut Model) -> Option<String> {
    model.images.values_mut().for_each(|image| image.name = image.name.replace('\\', "/"));
    let folder = images_dir(dir);
    let names: Vec<&str> = model.images.values().map(|image| image.name.as_str()).collect();
    let first = *names.first()?;
    if names.iter().any(|name| stored(&folder, name).is_some()) {
        return None;
    }
    let is_shared = |end: &usize| names.iter().all(|name| name.starts_with(&first[..*end]));
    let mut ends = first.match_indices('/').map(|(at, _)| at + 1).filter(is_shared);
    let end = ends.find(|end| stored(&folder, &first[*end..]).is_some())?;
    let warning = format!("image names are read without their folder {}", &first[..end]);
    model.images.values_mut().for_each(|image| image.name.drain(..end).for_each(drop));
    Some(warning)
}

/// An image name as a path inside the folder of images.
fn inside(name: &str) -> Result<PathBuf> {
    let path = PathBuf::from(name);
    if path.components().all(|part| matches!(part, Component::Normal(_))) {
        return Ok(path);
    }
    let hint = "image names are relative to images/: put the images there under the end of these names";
    Err(bad(format!("the image name {name} points outside the folder of images")).hint(hint))
}
