//! Rigs: cameras that film the same instants, each with the frames of its video.

mod boxes;
mod edits;
mod mp4;
pub(crate) mod videos;

use std::path::{Path, PathBuf};

use scene::{Intrinsics, RigidTransform, Split};

pub(crate) use self::videos::Video;
use crate::applied::Applied;
use crate::bounds::StatedBounds;
use crate::cloud_file::{CloudFile, CloudSource};
use crate::error::{Result, bad};
use crate::files;
use crate::image_names::view_name;
use crate::lens::Lens;
use crate::mask_polarity::SetPixels;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture, time_map};
use crate::split;

/// A fixed camera and its video.
pub(crate) struct RigCamera {
    /// The frames.
    pub(crate) video: Video,
    /// The lens, at the size of the frames.
    pub(crate) lens: Lens,
    /// World to view coordinates, with OpenCV's axes.
    pub(crate) camera_from_world: RigidTransform,
    /// One mask per frame, or none at all.
    pub(crate) masks: Vec<Option<PathBuf>>,
}

/// The largest distance of a principal point from the centre of the images, as a share of their width and height. Images
/// of half or twice the calibrated size have about a quarter or more.
const OFF_CENTER: f64 = 0.2;

/// Refuses images of another size than that of a calibration that does not state its size.
pub(crate) fn check_size(what: &str, intrinsics: &Intrinsics) -> Result<()> {
    let Intrinsics { width, height, center_x, center_y, .. } = *intrinsics;
    let is_off = |center: f64, side: u32| (center / f64::from(side) - 0.5).abs() >= OFF_CENTER;
    if !(is_off(center_x, width) || is_off(center_y, height)) {
        return Ok(());
    }
    let point = format!("({center_x:.1}, {center_y:.1})");
    let message = format!("the principal point of {what}, {point}, does not fit images of {width}×{height}");
    Err(bad(message).hint("use the images that were calibrated; `width` resizes them after the import"))
}

/// All frames for training, sorted by time, then camera. The instant of a frame is its rank, in units of 1 / `fps`.
pub(crate) fn frames(cameras: &[RigCamera], stated_in: &Path, fps: f64) -> Vec<Frame> {
    let mut frames = Vec::new();
    for (camera_index, camera) in (0..).zip(cameras) {
        let name = view_name(&format!("{}.", camera.video.camera));
        frames.extend((0..).zip(&camera.video.frames).map(|(frame_index, image)| Frame {
            name: format!("{name}_{frame_index:04}"),
            split: Split::Train,
            image: image.clone(),
            stored_image: camera.video.stored(frame_index),
            mask: camera.masks.get(frame_index as usize).cloned().flatten(),
            depth: None,
            lens: camera.lens,
            camera_from_world: camera.camera_from_world,
            camera_index,
            frame_index,
            time_secs: f64::from(frame_index) / fps,
            stated_in: stated_in.to_owned(),
        }));
    }
    frames.sort_by_key(|frame: &Frame| (frame.frame_index, frame.camera_index));
    frames
}

/// Makes the frames of `held_out` cameras test views, and returns the rule. Without such cameras, every `every_nth`-th
/// camera is held out.
pub(crate) fn hold_out(
    frames: &mut [Frame],
    cameras: &[RigCamera],
    held_out: &[String],
    params: &Params,
) -> Result<String> {
    if held_out.is_empty() {
        return Ok(split::hold_out(frames, false, params));
    }
    let names: Vec<&str> = cameras.iter().map(|camera| camera.video.camera.as_str()).collect();
    let index = |name: &str| names.iter().position(|known| *known == name).map(|index| index as u32);
    hold_out_named(frames, held_out, &names, index)
}

/// Makes the frames of `held_out` cameras the only test views, and returns the rule. `known` are the names of all cameras,
/// and `index` returns the index of the camera with a name.
pub(crate) fn hold_out_named(
    frames: &mut [Frame],
    held_out: &[String],
    known: &[impl AsRef<str>],
    index: impl Fn(&str) -> Option<u32>,
) -> Result<String> {
    let missing = |name: &str| {
        let found: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
        let message = format!("the test camera {name} is missing (found {})", found.join(", "));
        bad(message).hint("download its frames, or set test_cameras to cameras of this rig")
    };
    let cameras = held_out.iter().map(|name| index(name).ok_or_else(|| missing(name))).collect::<Result<Vec<u32>>>()?;
    for frame in frames {
        frame.split = if cameras.contains(&frame.camera_index) { Split::Test } else { Split::Train };
    }
    let plural = if held_out.len() == 1 { "camera" } else { "cameras" };
    Ok(format!("{plural} {} held out", held_out.join(" ")))
}

/// The capture of these frames, whose test views are marked by `rules`, which the protocol states. It has no points yet.
pub(crate) fn capture(
    dir: &Path,
    (format, dataset): (Format, &'static str),
    mut frames: Vec<Frame>,
    mut rules: Vec<String>,
    params: &Params,
) -> SourceCapture {
    let is_static = params.is_static() || frames.iter().all(|frame| frame.frame_index == frames[0].frame_index);
    if is_static {
        at_one_instant(&mut frames);
    }
    let time_map = time_map(&frames, is_static, params.fps);
    rules.extend(split::refine(&mut frames, params));
    SourceCapture {
        name: files::name(dir),
        format,
        dataset,
        wants_test: params.every_nth > 0 || !params.test_cameras.is_empty(),
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "index / (count - 1)".into() },
        time_map,
        frames,
        points: Vec::new(),
        set_pixels: SetPixels::Unstated,
        cloud: None,
        stated_bounds: StatedBounds::default(),
        quality: None,
        warnings: Vec::new(),
    }
}

/// The cloud in the first of these files that exists; otherwise points are triangulated from the images.
pub(crate) fn cloud(files: impl IntoIterator<Item = PathBuf>) -> CloudSource {
    let file = files.into_iter().find(|path| path.is_file());
    file.map_or(CloudSource::Sweep(None), |path| CloudSource::File(CloudFile { path, applied: Applied::IDENTITY }))
}

/// Puts all frames at one instant, with a camera each.
fn at_one_instant(frames: &mut [Frame]) {
    frames.iter_mut().zip(0..).for_each(|(frame, index)| {
        (frame.camera_index, frame.frame_index, frame.time_secs) = (index, 0, 0.0);
    });
}
