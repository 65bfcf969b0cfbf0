//! A capture before any pixel is decoded: frames with poses, times and splits, and the problems of these.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use captures::video;
use engine::Failure;
use rayon::prelude::*;
use scene::{Camera, Intrinsics, RigidTransform, Split, TimeMap};
use serde::Serialize;

use crate::bounds::{BoxWorld, StatedBounds, bounds};
use crate::cloud_file::{CloudSource, Points};
use crate::depth::DepthFile;
use crate::error::{Result, about, bad, invalid};
use crate::files::image_size;
use crate::lens::Lens;
use crate::mask_polarity::SetPixels;
use crate::params::Format;
use crate::stored_image::StoredImage;

/// Largest distance of a camera from the origin: beyond it, neighbouring single-precision numbers are more than 1/16
/// apart.
const MAX_DISTANCE: f64 = 1e6;
/// Plausible fields of view of a pinhole: from a telescope to some margin above the widest rectilinear lenses (150°).
const VIEW_DEGREES: std::ops::RangeInclusive<f64> = 0.01..=170.0;

/// Everything that the files of a capture state, except pixels.
pub(crate) struct SourceCapture {
    /// The folder's name.
    pub(crate) name: String,
    /// The recognised format; never [`Format::Auto`].
    pub(crate) format: Format,
    /// The benchmark or, for captures of no known benchmark, the layout; for the protocol, e.g. `dnerf` or `colmap`.
    pub(crate) dataset: &'static str,
    /// The rule that split the views into train, val and test, for the protocol.
    pub(crate) split_rule: String,
    /// Whether the parameters request test views.
    pub(crate) wants_test: bool,
    /// The rule that maps times to [0, 1], for the protocol.
    pub(crate) time_rule: String,
    /// The time range over all splits, before any subsampling.
    pub(crate) time_map: TimeMap,
    /// The frames to import.
    pub(crate) frames: Vec<Frame>,
    /// World positions and sRGB colours of the sparse cloud; empty if there is none.
    pub(crate) points: Points,
    /// What the set pixels of masks show.
    pub(crate) set_pixels: SetPixels,
    /// The source of further points.
    pub(crate) cloud: Option<CloudSource>,
    /// The extent of the scene as stated by the files.
    pub(crate) stated_bounds: StatedBounds,
    /// The quality of structure from motion, for COLMAP models.
    pub(crate) quality: Option<Quality>,
    /// Oddities that do not prevent an import.
    pub(crate) warnings: Vec<String>,
}

/// The quality of structure from motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Number of images with a pose.
    pub registered: usize,
    /// Number of images.
    pub images: usize,
    /// Reprojection error of the points, if there are any.
    pub reprojection: Option<ReprojectionError>,
}

/// Reprojection error in pixels: recomputed from poses and observations, and as stored by COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReprojectionError {
    /// Mean over points of the mean distance over their tracks.
    pub recomputed_px: f64,
    /// Mean over points of the stored error.
    pub stored_px: f64,
}

impl ReprojectionError {
    /// Larger than the width of any image.
    const IMPLAUSIBLE_PX: f64 = 1e6;

    /// Whether the error is below any plausible image size; a larger error has no meaning.
    pub(crate) fn is_plausible(&self) -> bool {
        self.recomputed_px < Self::IMPLAUSIBLE_PX
    }
}

/// One image file with its camera and time.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Unique name, safe as a file name.
    pub(crate) name: String,
    /// The split that the view belongs to.
    pub(crate) split: Split,
    /// The image file, or the video or the file of the array that holds the image.
    pub(crate) image: PathBuf,
    /// The place of the image in that file, if the image has no separate file.
    pub(crate) stored_image: Option<StoredImage>,
    /// The instance mask, if there is one.
    pub(crate) mask: Option<PathBuf>,
    /// The depth map, if there is one.
    pub(crate) depth: Option<DepthFile>,
    /// Intrinsics and distortion.
    pub(crate) lens: Lens,
    /// World to view coordinates, with OpenCV's axes (x right, y down, z forward).
    pub(crate) camera_from_world: RigidTransform,
    /// Index of the camera in a rig.
    pub(crate) camera_index: u32,
    /// Frame number within that camera's video.
    pub(crate) frame_index: u32,
    /// Time in seconds.
    pub(crate) time_secs: f64,
    /// The file that states pose and time.
    pub(crate) stated_in: PathBuf,
}

/// The time map from the first to the last frame, at `fps` frames per second; one instant for a static capture.
pub(crate) fn time_map(frames: &[Frame], is_static: bool, fps: f64) -> TimeMap {
    if is_static || frames.is_empty() {
        return TimeMap { start_secs: 0.0, end_secs: 0.0, frame_secs: 1.0 };
    }
    let [start_secs, end_secs] = time_range_secs(frames);
    TimeMap { start_secs, end_secs, frame_secs: 1.0 / fps }
}

/// The first and the last time; infinite if there are no frames.
pub(crate) fn time_range_secs(frames: &[Frame]) -> [f64; 2] {
    let times = frames.iter().map(|frame| frame.time_secs);
    times.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], time| [low.min(time), high.max(time)])
}

impl SourceCapture {
    /// Everything that makes the capture unusable, in a fixed order; empty for a usable capture.
    pub(crate) fn problems(&self) -> Vec<Failure> {
        let mut problems = self.split_problems();
        problems.extend(self.frames.par_iter().filter_map(|frame| frame.check().err()).collect::<Vec<_>>());
        problems.extend(self.name_problems());
        problems.extend(self.time_problems());
        problems.extend(self.time_map_problem());
        problems.extend(self.size_problem());
        let in_video = self.frames.iter().any(|frame| frame.in_video().is_some());
        problems.extend(in_video.then(|| video::version().err()).flatten());
        problems
    }

    /// Whether the imported capture has points; `None` if the import has yet to triangulate them.
    pub(crate) fn has_cloud(&self) -> Option<bool> {
        match &self.cloud {
            _ if !self.points.is_empty() => Some(true),
            Some(CloudSource::Sweep(_)) => None,
            cloud => Some(cloud.is_some()),
        }
    }

    /// Whether all views have one time.
    pub(crate) fn is_one_instant(&self) -> bool {
        !(self.time_map.end_secs > self.time_map.start_secs)
    }

    /// The bounding box of the scene: as stated, around the cloud, or around what the cameras see.
    pub(crate) fn bounds_world(&self) -> Option<BoxWorld> {
        bounds(&self.cameras(), &self.points, &self.stated_bounds)
    }

    /// The plausible training cameras, without their distortion.
    pub(crate) fn cameras(&self) -> Vec<Camera> {
        let train = self.frames.iter().filter(|frame| frame.split == Split::Train && frame.check_range().is_ok());
        train
            .map(|frame| Camera { intrinsics: frame.lens.intrinsics, camera_from_world: frame.camera_from_world })
            .collect()
    }

    /// The files that an import reads: images, masks, depth maps, the cloud, and the files that state poses. A path that
    /// names a folder stands for the files in it.
    pub(crate) fn used_files(&self) -> BTreeSet<PathBuf> {
        let mut used = BTreeSet::new();
        match &self.cloud {
            Some(CloudSource::File(file)) => _ = used.insert(file.path.clone()),
            Some(CloudSource::Model(sparse)) => _ = used.insert(sparse.clone()),
            Some(CloudSource::Depth | CloudSource::Sweep(_)) | None => (),
        }
        for Frame { image, mask, depth, stated_in, .. } in &self.frames {
            let depth = depth.as_ref().map(|depth| &depth.path);
            used.extend([Some(image), mask.as_ref(), depth, Some(stated_in)].into_iter().flatten().cloned());
        }
        used
    }

    /// Number of frames of one split.
    pub(crate) fn count(&self, split: Split) -> usize {
        self.frames.iter().filter(|frame| frame.split == split).count()
    }

    /// Number of distinct cameras.
    pub(crate) fn camera_count(&self) -> usize {
        self.frames.iter().map(|frame| frame.camera_index).collect::<BTreeSet<_>>().len()
    }

    /// Number of distinct cameras with training views.
    pub(crate) fn training_camera_count(&self) -> usize {
        let train = self.frames.iter().filter(|frame| frame.split == Split::Train);
        train.map(|frame| frame.camera_index).collect::<BTreeSet<_>>().len()
    }

    fn split_problems(&self) -> Vec<Failure> {
        let empty = |split: Split, hint: String| {
            let message = format!("the {} split of {} is empty", split.name(), self.name);
            (self.count(split) == 0).then(|| bad(message).hint(hint))
        };
        let needed = match self.count(Split::Val) {
            0 => "training needs views: change every_nth, val_count or the split files".into(),
            val => format!(
                "training needs views: if val_count holds out the {val} validation views, set it below {val}; otherwise change \
                 every_nth or the split files"
            ),
        };
        let train = empty(Split::Train, needed);
        let test = empty(Split::Test, "metrics need test views: change every_nth or test_split".into());
        train.into_iter().chain(test.filter(|_| self.wants_test)).collect()
    }

    /// Numbers different images whose names would be equal, e.g. those of `a.png` and `a.tif`, in the order of their paths.
    pub(crate) fn number_equal_names(&mut self) {
        let mut taken: BTreeSet<String> = BTreeSet::new();
        let mut images: BTreeMap<String, BTreeSet<PathBuf>> = BTreeMap::new();
        for frame in self.frames.iter().filter(|frame| frame.stored_image.is_none()) {
            taken.insert(frame.name.clone());
            images.entry(frame.name.clone()).or_default().insert(frame.image.clone());
        }
        let mut numbered: BTreeMap<PathBuf, String> = BTreeMap::new();
        for (name, images) in images {
            for image in images.into_iter().skip(1) {
                let mut names = (2_u32..).map(|number| format!("{name}-{number}"));
                let free = names.find(|name| taken.insert(name.clone()));
                numbered.extend(free.map(|free| (image, free)));
            }
        }
        for frame in self.frames.iter_mut().filter(|frame| frame.stored_image.is_none()) {
            frame.name = numbered.get(&frame.image).unwrap_or(&frame.name).clone();
        }
    }

    fn name_problems(&self) -> Vec<Failure> {
        let mut seen = BTreeSet::new();
        let repeated = self.frames.iter().filter(|frame| !seen.insert(&frame.name));
        let hint = "list every image once; if the views differ, copy the image under another name";
        repeated.map(|frame| bad(format!("two views are named {}", frame.name)).hint(hint).at(&frame.image)).collect()
    }

    /// Reports frames whose time does not increase. Each camera has one view per instant, and readers sort them by time.
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
            let hint = "a camera has one view per instant: remove the duplicates, or correct the times";
            problems.push(bad(message).hint(hint).at(&frame.stated_in));
        }
        problems
    }

    /// Reports a time map whose numbers overflow, with the frame whose time is the farthest from 0.
    fn time_map_problem(&self) -> Option<Failure> {
        let error = self.time_map.check().err()?;
        let farthest = self.frames.iter().max_by(|a, b| a.time_secs.abs().total_cmp(&b.time_secs.abs()))?;
        let message = format!("{}: the time is {:e} s: {}", farthest.name, farthest.time_secs, error.message);
        let is_reported = !farthest.time_secs.is_finite();
        (!is_reported).then(|| bad(message).hint("correct the times of the frames").at(&farthest.stated_in))
    }

    /// Reports the sizes of the views if they have more than one, the most frequent first, and an image of the rarest.
    fn size_problem(&self) -> Option<Failure> {
        let mut by_size: BTreeMap<(u32, u32), Vec<&Frame>> = BTreeMap::new();
        for frame in &self.frames {
            let lens = frame.lens.intrinsics;
            by_size.entry((lens.width, lens.height)).or_default().push(frame);
        }
        if by_size.len() < 2 {
            return None;
        }
        let mut sizes: Vec<_> = by_size.into_iter().collect();
        sizes.sort_by_key(|(_, frames)| std::cmp::Reverse(frames.len()));
        let rarest = sizes.last().map(|(_, frames)| &frames[0].image)?;
        let shown = |((width, height), frames): &((u32, u32), Vec<&Frame>)| {
            format!("{} of {width}×{height} (e.g. {})", frames.len(), frames[0].name)
        };
        let message = format!("views differ in size: {}", sizes.iter().map(shown).collect::<Vec<_>>().join(", "));
        let hint = "all views of a capture need one size: crop or resize the images before structure from motion, or \
                    remove the frames of other sizes";
        Some(bad(message).hint(hint).at(rarest))
    }
}

/// What to do with an image of another size than stated.
fn other_size_hint(stated: (u32, u32), found: (u32, u32)) -> String {
    let hint = "use the images that the poses were computed from";
    let factor = stated.0.checked_div(found.0).unwrap_or(0);
    if factor < 2 || stated != (factor * found.0, factor * found.1) {
        return hint.into();
    }
    format!(
        "{hint}; if these are copies at 1/{factor} of the size, name their folder images_{factor} (COLMAP), or divide w, h, fl_x, \
         fl_y, cx and cy by {factor} (transforms files)"
    )
}

impl Frame {
    /// The undistorted camera at native size.
    pub(crate) fn camera(&self) -> Result<Camera> {
        let intrinsics = self.lens.undistorted().map_err(|failure| failure.at(&self.stated_in))?;
        Ok(Camera { intrinsics, camera_from_world: self.camera_from_world })
    }

    /// Checks for a finite pose and time, an image file of the stated size, and an invertible distortion.
    fn check(&self) -> Result<()> {
        let pinhole = Camera { intrinsics: self.lens.intrinsics, camera_from_world: self.camera_from_world };
        pinhole.check().map_err(|error| self.blame(invalid(error)))?;
        self.check_range()?;
        if !self.time_secs.is_finite() {
            return Err(bad(format!("{}: the time is {}", self.name, self.time_secs)).at(&self.stated_in));
        }
        let stated = (self.lens.intrinsics.width, self.lens.intrinsics.height);
        let found = self.stored_image.as_ref().map_or_else(|| image_size(&self.image), |stored| Ok(stored.size()))?;
        if found != stated {
            let message = format!(
                "image is {}×{}, but {}×{} is expected from the other views or the camera file",
                found.0, found.1, stated.0, stated.1
            );
            let is_turned = found == (stated.1, stated.0);
            let hint = if is_turned {
                "the images are turned by 90°, perhaps by an EXIF orientation that is not applied here: turn the pixels, e.g. \
                 with `mogrify -auto-orient *.jpg`"
                    .into()
            } else {
                other_size_hint(stated, found)
            };
            return Err(bad(message).hint(hint).at(&self.image));
        }
        self.camera().map(|_| ())
    }

    /// Checks that single precision suffices for splats at this distance and field of view.
    fn check_range(&self) -> Result<()> {
        let distance = self.camera_from_world.translation.length();
        if !(distance <= MAX_DISTANCE) {
            let message = format!("the camera is {distance:.2e} units from the origin");
            let hint = format!(
                "subtract an offset from poses and points, or divide both by a factor: single precision is too coarse beyond \
                 {MAX_DISTANCE:e} units"
            );
            return Err(self.blame(bad(message).hint(hint)));
        }
        check_lens(&self.lens.intrinsics).map_err(|failure| self.blame(failure))
    }

    /// The failure with the frame and the file that states it.
    fn blame(&self, failure: Failure) -> Failure {
        about(&self.name, failure).at(&self.stated_in)
    }
}

/// Checks that a pinhole can have this field of view, and this distance of the image from the optical axis.
fn check_lens(lens: &Intrinsics) -> Result<()> {
    let Intrinsics { width, height, focal_x, focal_y, center_x, center_y } = *lens;
    let degrees = |pixels: u32, focal: f64| (2.0 * (0.5 * f64::from(pixels) / focal).atan()).to_degrees();
    let views = [degrees(width, focal_x), degrees(height, focal_y)];
    if let Some(view) = views.into_iter().find(|view| !VIEW_DEGREES.contains(view)) {
        let view = if view < *VIEW_DEGREES.start() { format!("{view:.2e}") } else { format!("{view:.1}") };
        let message = format!("a field of view of {view}° is impossible for a pinhole");
        return Err(bad(message).hint("state angles in radians and focal lengths in pixels of these images"));
    }
    let most_degrees = 0.5 * VIEW_DEGREES.end();
    let is_too_far = |(_, center, pixels, focal): &(&str, f64, u32, f64)| {
        let outside_px = (-center).max(center - f64::from(*pixels)).max(0.0);
        (outside_px / focal).atan().to_degrees() > most_degrees
    };
    let axes = [("cx", center_x, width, focal_x), ("cy", center_y, height, focal_y)];
    if let Some((key, center, ..)) = axes.into_iter().find(is_too_far) {
        let message = format!(
            "the principal point, {key} = {center:e} px, is impossible for an image of {width}×{height} pixels: all of them are \
             more than {most_degrees}° from the optical axis"
        );
        return Err(bad(message).hint("state the principal point in pixels of these images"));
    }
    Ok(())
}
