//! A recognised capture before any pixel is read: posed, timed and split frames, and what is wrong with them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use rayon::prelude::*;
use scene::{Camera, RigidTransform, Split, TimeMap};
use serde::Serialize;

use crate::colmap::model::ReprojectionError;
use crate::lens::Lens;
use crate::params::Format;
use crate::recognise::recognise;
use crate::{Params, blender, colmap, n3v, nerfies};

/// Units from the origin beyond which neighbouring numbers of single precision lie more than 1/16 apart.
const MAX_DISTANCE: f64 = 1e6;
/// Fields of view of pinholes: a telescope's to the widest lenses without a fisheye's distortion (150°) and some room.
const VIEW_DEGREES: std::ops::RangeInclusive<f64> = 0.01..=170.0;

/// Results of this crate: every error has a kind, a message, a hint and a file.
pub type Result<T> = std::result::Result<T, Failure>;

/// Everything that the files say, except pixels.
pub struct SourceCapture {
    /// The folder's name.
    pub name: String,
    /// What the folder was recognised as; never [`Format::Auto`].
    pub format: Format,
    /// The benchmark, for the protocol: `dnerf`, `blender`, `colmap`, `nerfies`, `dycheck` or `n3v`.
    pub dataset: &'static str,
    /// How views became train, val and test.
    pub split_rule: String,
    /// Whether test views are wanted.
    pub wants_test: bool,
    /// How times became [0, 1].
    pub time_rule: String,
    /// Over all splits, before any subsampling.
    pub time_map: TimeMap,
    /// Every image that is imported.
    pub frames: Vec<Frame>,
    /// World positions and sRGB colours of a sparse cloud; empty where there is none.
    pub points: Vec<([f64; 3], [u8; 3])>,
    /// The box that holds the scene, where the literature fixes it.
    pub bounds_world: Option<[[f64; 3]; 2]>,
    /// How well structure from motion went, where it was run.
    pub quality: Option<Quality>,
    /// Odd, but not wrong.
    pub warnings: Vec<String>,
}

/// How well structure from motion went.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Images with a pose.
    pub registered: usize,
    /// Images.
    pub images: usize,
    /// Of the points, where there are any.
    pub reprojection: Option<ReprojectionError>,
}

/// One image file with its camera and time.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Unique, safe as a file name.
    pub name: String,
    /// What the view may be used for.
    pub split: Split,
    /// The image file.
    pub image: PathBuf,
    /// Its instance mask, where there is one.
    pub mask: Option<PathBuf>,
    /// How it was taken.
    pub lens: Lens,
    /// World to view coordinates (OpenCV axes).
    pub camera_from_world: RigidTransform,
    /// Which camera of a rig.
    pub camera_index: u32,
    /// Frame number within that camera's video.
    pub frame_index: u32,
    /// When it was taken.
    pub time_secs: f64,
    /// The file that states pose and time.
    pub stated_in: PathBuf,
}

/// Reads the capture in `dir` as `params` say; opens no image beyond its header.
pub fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    match recognise(dir, params.format)? {
        Format::Colmap => colmap::read(dir, params),
        Format::Nerfies => nerfies::read(dir, params),
        Format::N3v => n3v::read(dir, params),
        _ => blender::read(dir, params),
    }
}

impl SourceCapture {
    /// Everything that makes the capture unusable, in a fixed order; empty for a good one.
    pub fn problems(&self) -> Vec<Failure> {
        let mut problems = self.split_problems();
        problems.extend(self.frames.par_iter().filter_map(|frame| frame.check().err()).collect::<Vec<_>>());
        problems.extend(self.name_problems());
        problems.extend(self.time_problems());
        problems.extend(self.size_problem());
        problems
    }

    /// Frames of one split.
    pub fn count(&self, split: Split) -> usize {
        self.frames.iter().filter(|frame| frame.split == split).count()
    }

    /// Number of cameras that move or stand on their own.
    pub fn camera_count(&self) -> usize {
        self.frames.iter().map(|frame| frame.camera_index).collect::<BTreeSet<_>>().len()
    }

    fn split_problems(&self) -> Vec<Failure> {
        let empty = |split, hint| {
            let message = format!("the {} split of {} is empty", format!("{split:?}").to_lowercase(), self.name);
            (self.count(split) == 0).then(|| bad(message).hint(hint))
        };
        let train = empty(Split::Train, "nothing can be trained: change every_nth, val_count or the split files");
        let test = empty(Split::Test, "nothing could be measured: change every_nth or test_split");
        train.into_iter().chain(test.filter(|_| self.wants_test)).collect()
    }

    fn name_problems(&self) -> Vec<Failure> {
        let mut seen = BTreeMap::new();
        let mut problems = Vec::new();
        for frame in &self.frames {
            if let Some(other) = seen.insert(&frame.name, &frame.image) {
                let message = format!("two images would both be called {}: {} and this", frame.name, other.display());
                problems.push(bad(message).at(&frame.image));
            }
        }
        problems
    }

    /// One camera has one view per instant; importers list them in order of time.
    fn time_problems(&self) -> Vec<Failure> {
        let mut last: BTreeMap<(Split, u32), &Frame> = BTreeMap::new();
        let mut problems = Vec::new();
        for frame in &self.frames {
            let Some(before) = last.insert((frame.split, frame.camera_index), frame) else { continue };
            if frame.time_secs > before.time_secs {
                continue;
            }
            let message = format!(
                "{} (time {}) does not come after {} (time {})",
                frame.name, frame.time_secs, before.name, before.time_secs
            );
            let hint = "one camera has one view per instant: remove the others, or correct the times";
            problems.push(bad(message).hint(hint).at(&frame.stated_in));
        }
        problems
    }

    /// Views of one capture have one size.
    fn size_problem(&self) -> Option<Failure> {
        let first = self.frames.first()?;
        let (width, height) = (first.lens.intrinsics.width, first.lens.intrinsics.height);
        let other = self.frames.iter().find(|frame| {
            let intrinsics = frame.lens.intrinsics;
            (intrinsics.width, intrinsics.height) != (width, height)
        })?;
        let (w, h) = (other.lens.intrinsics.width, other.lens.intrinsics.height);
        let message = format!("views differ in size: {} is {width}×{height}, {} is {w}×{h}", first.name, other.name);
        Some(bad(message).hint("crop or resize the images to one size before structure from motion").at(&other.image))
    }
}

impl Frame {
    /// The camera at native size, without distortion.
    pub fn camera(&self) -> Result<Camera> {
        let intrinsics = self.lens.undistorted().map_err(|failure| failure.at(&self.stated_in))?;
        Ok(Camera { intrinsics, camera_from_world: self.camera_from_world })
    }

    /// A finite pose and time, an image file of the stated size, and a distortion that can be undone.
    fn check(&self) -> Result<()> {
        let pinhole = Camera { intrinsics: self.lens.intrinsics, camera_from_world: self.camera_from_world };
        pinhole.check().map_err(|error| bad(format!("{}: {}", self.name, error.message)).at(&self.stated_in))?;
        self.check_range()?;
        if !self.time_secs.is_finite() {
            return Err(bad(format!("{}: the time is {}", self.name, self.time_secs)).at(&self.stated_in));
        }
        let stated = (self.lens.intrinsics.width, self.lens.intrinsics.height);
        let found = image_size(&self.image)?;
        if found != stated {
            let message = format!(
                "image is {}×{} where {}×{} is expected from the other views or the camera file",
                found.0, found.1, stated.0, stated.1
            );
            return Err(bad(message).hint("use the images that the poses were computed from").at(&self.image));
        }
        self.camera().map(|_| ())
    }

    /// Whether splats can be computed in single precision from here.
    fn check_range(&self) -> Result<()> {
        let distance = self.camera_from_world.translation.length();
        if !(distance <= MAX_DISTANCE) {
            let message = format!("{}: the camera is {distance:e} units from the origin", self.name);
            let hint =
                format!("centre and scale the poses: single precision is too coarse beyond {MAX_DISTANCE:e} units");
            return Err(bad(message).hint(hint).at(&self.stated_in));
        }
        let k = self.lens.intrinsics;
        let degrees = |pixels: u32, focal: f64| (2.0 * (0.5 * f64::from(pixels) / focal).atan()).to_degrees();
        let views = [degrees(k.width, k.focal_x), degrees(k.height, k.focal_y)];
        match views.into_iter().find(|view| !VIEW_DEGREES.contains(view)) {
            None => Ok(()),
            Some(view) => {
                let message = format!("{}: the camera sees {view:.2e}°, which no pinhole does", self.name);
                let hint = "angles are in radians, focal lengths in pixels of these images";
                Err(bad(message).hint(hint).at(&self.stated_in))
            }
        }
    }
}

/// Width and height from the file's header.
pub fn image_size(path: &Path) -> Result<(u32, u32)> {
    if !path.is_file() {
        let hint = "download the capture again, or remove the frame from the file that names it";
        return Err(Failure::new(FailureKind::MissingData, "image file is missing").hint(hint).at(path));
    }
    image::image_dimensions(path).map_err(|error| bad(format!("image cannot be read ({error})")).at(path))
}

/// Bad input with a message.
pub fn bad(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::BadInput, message)
}

/// Reads a whole file.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| {
        let kind = match error.kind() {
            std::io::ErrorKind::NotFound => FailureKind::MissingData,
            _ => FailureKind::World,
        };
        Failure::new(kind, format!("cannot read the file ({error})")).at(path)
    })
}
