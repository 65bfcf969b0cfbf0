//! Description of the captures in a folder: a text for the terminal, and a recipe that trains on them.

mod companions;
mod ignored;
mod recipe;
mod samples;
mod suggestion;
mod summary;
mod video;
mod views;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;

pub use self::companions::{CoVisible, Companions, DepthPlace, MaskPlace};
pub use self::recipe::scene_name;
pub use self::samples::Samples;
pub use self::summary::{Frames, Summary};
use crate::colmap::read_model;
use crate::files;
pub use crate::foreign::next_step_for_file;
use crate::image_names::{image_names, images_dir};
use crate::params::Format;
use crate::recognise::{captures_below, is_capture};
pub use crate::source::{Quality, ReprojectionError};

/// Maximum number of images that are decoded per capture.
const CAPTURE_IMAGES: usize = 8;
/// Maximum number of images that are decoded in a folder of captures.
const FOLDER_IMAGES: usize = 32;

/// An inspected folder.
pub struct Inspection {
    dir: PathBuf,
    /// The capture in the folder, or every capture directly below it.
    pub captures: Vec<Summary>,
}

/// The factor by which the distance of the points differs between the images of a COLMAP model, if it is so large that the
/// model has lost its scale and is unusable. `None` if it has not, or if `model` has no readable model.
pub fn lost_scale(model: &Path) -> Option<f64> {
    read_model(model).ok()?.lost_scale()
}

/// Inspects the capture in `dir`, or every capture directly below it. A folder that cannot be opened is an error; problems
/// of captures are part of the result.
pub fn inspect(dir: &Path) -> anyhow::Result<Inspection> {
    inspect_as(dir, Format::Auto)
}

/// Inspects a folder as [`inspect`] does, and reads its captures in the format `wanted`.
pub fn inspect_as(dir: &Path, wanted: Format) -> anyhow::Result<Inspection> {
    let dir = dir.canonicalize().with_context(|| format!("cannot open the folder: {}", dir.display()))?;
    let below = captures_below(&dir);
    let captures = if !is_capture(&dir) && !below.is_empty() {
        let images = (FOLDER_IMAGES / below.len()).clamp(1, CAPTURE_IMAGES);
        below.iter().map(|path| Summary::of(path, wanted, images)).collect()
    } else {
        vec![Summary::of(&dir, wanted, CAPTURE_IMAGES)]
    };
    Ok(Inspection { dir, captures })
}

/// How to join COLMAP captures of one instant each, if they have the same images: they are probably instants of one rig.
fn instants_of_a_rig(captures: &[Summary]) -> Option<String> {
    let is_instant = |summary: &Summary| {
        let frames = summary.frames.as_ref();
        summary.format == Format::Colmap && frames.is_some_and(|frames| frames.time_range_secs.is_none())
    };
    let names = |summary: &Summary| image_names(&images_dir(&summary.path));
    let cameras = names(captures.first()?);
    if cameras.len() < 2 || !captures.iter().all(|summary| is_instant(summary) && names(summary) == cameras) {
        return None;
    }
    let (camera, extension) = cameras[0].rsplit_once('.')?;
    let instant = files::name(&captures[0].path);
    Some(format!(
        "all captures have the same image names: if they are instants of one rig, join them in one folder, with the model of one of \
         them in sparse/0 and a folder of frames per camera, e.g. {camera}/{instant}.{extension}\n"
    ))
}

impl Inspection {
    /// The report: a description of every capture, then the recipe.
    pub fn text(&self) -> String {
        let mut text = self.captures.iter().map(Summary::text).collect::<Vec<_>>().join("\n");
        if self.captures.len() > 1 {
            let ready = self.captures.iter().filter(|summary| summary.params.is_some()).count();
            write!(text, "\n{ready} of {} captures are ready to import\n", self.captures.len())
                .expect("writing to a string cannot fail");
            text += &instants_of_a_rig(&self.captures).unwrap_or_default();
        }
        let indented = |recipe: String| recipe.lines().map(|line| format!("  {line}\n")).collect::<String>();
        text + &self.recipe().map(|recipe| format!("\n{}", indented(recipe))).unwrap_or_default()
    }

    /// A recipe that trains on every importable capture, to be saved in the folder `recipes`; `None` if there is no
    /// importable capture.
    pub fn recipe(&self) -> Option<String> {
        recipe::of(&self.dir, &self.captures)
    }
}
