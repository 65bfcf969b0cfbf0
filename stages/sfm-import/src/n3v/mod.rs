//! Neural 3D Video (Li et al. 2022), also called DyNeRF or Plenoptic Video: a rig of fixed cameras. Each camera has a row in
//! `poses_bounds.npy` and the frames of its video in `camNN/images` or `camNN`.
//!
//! Rows correspond to cameras in the order of their names. `cam00` is the test camera; all others are for training.

mod poses;
pub(crate) mod videos;

use std::path::Path;

use scene::{Camera, PointCloud, Split};

use self::videos::Video;
pub(crate) use self::videos::camera_names;
use crate::bounds::StatedBounds;
use crate::error::{Result, bad};
use crate::files::{self, image_size};
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture, time_map};
use crate::split;

/// The test camera, at the centre of the rig.
const HELD_OUT: &str = "cam00";
/// Number of frames that published numbers are measured on: all frames of a scene, or the first of flame_salmon's 1200.
const FRAMES: usize = 300;
/// File names of the point cloud of the first frame, in world coordinates of the poses, as in loaders derived from
/// 4DGaussians.
const POINTS: [&str; 2] = ["points3D_downsample2.ply", "points3D.ply"];
/// A flaw of the benchmark.
const UNSYNCHRONISED: &str =
    "N3V's coffee_martini: cam13 is badly synchronised; published tables keep it, omit it, or omit the scene";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(poses::FILE).is_file() && !camera_names(dir).is_empty()
}

/// Reads the poses and the names of the frames; opens images no further than their headers.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let mut videos = videos::read(dir)?;
    let names: Vec<&str> = videos.iter().map(|video| video.camera.as_str()).collect();
    if !names.contains(&HELD_OUT) {
        let message = format!("the test camera {HELD_OUT} is missing (found {})", names.join(", "));
        let hint = "download or extract its frames; the protocol of Neural 3D Video holds out this camera";
        return Err(bad(message).hint(hint).at(dir));
    }
    if dir.ends_with("coffee_martini") && names.contains(&"cam13") {
        warnings.push(UNSYNCHRONISED.into());
    }
    let cameras = poses::read(&dir.join(poses::FILE), &names)?;
    let reduction = reduction(&videos[0].frames[0], &cameras[0])?;
    let count = keep_first(&mut videos, &mut warnings);
    let is_static = params.static_scene || count == 1;
    let mut frames = frames(&videos, &cameras, reduction, &dir.join(poses::FILE), params.fps);
    if is_static {
        frames.iter_mut().zip(0..).for_each(|(frame, index)| {
            (frame.camera_index, frame.frame_index, frame.time_secs) = (index, 0, 0.0);
        });
    }
    let time_map = time_map(&frames, is_static, params.fps);
    let mut rules = split_rules(count, reduction);
    rules.extend(split::refine(&mut frames, params));
    Ok(SourceCapture {
        name: files::name(dir),
        format: Format::N3v,
        dataset: "n3v",
        wants_test: true,
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "index / (count - 1)".into() },
        time_map,
        frames,
        points: points(dir, &mut warnings)?,
        cloud: None,
        stated_bounds: StatedBounds::default(),
        quality: None,
        warnings,
    })
}

/// The integer factor by which the images are smaller than the videos that the poses describe. Returns 1 if the sizes are
/// not in such a ratio; each image is then reported for its size.
fn reduction(image: &Path, camera: &Camera) -> Result<u32> {
    let (width, height) = image_size(image)?;
    let full = camera.intrinsics;
    let factor = (f64::from(full.width) / f64::from(width)).round().max(1.0) as u32;
    let is_fraction = reduced(full.width, factor) == width && reduced(full.height, factor) == height;
    Ok(if is_fraction { factor } else { 1 })
}

fn reduced(side: u32, factor: u32) -> u32 {
    (f64::from(side) / f64::from(factor)).round() as u32
}

/// Keeps the frames that published numbers are measured on, and returns their count.
fn keep_first(videos: &mut [Video], warnings: &mut Vec<String>) -> usize {
    let found = videos[0].frames.len();
    if found > FRAMES {
        warnings.push(format!("only the first {FRAMES} of {found} frames are used, as in the literature"));
        videos.iter_mut().for_each(|video| video.frames.truncate(FRAMES));
    }
    found.min(FRAMES)
}

/// All frames, sorted by time, then camera.
fn frames(videos: &[Video], cameras: &[Camera], reduction: u32, stated_in: &Path, fps: f64) -> Vec<Frame> {
    let mut frames = Vec::new();
    for (camera_index, (video, camera)) in (0..).zip(videos.iter().zip(cameras)) {
        let full = camera.intrinsics;
        let camera = camera.resized(reduced(full.width, reduction), reduced(full.height, reduction));
        frames.extend((0..).zip(&video.frames).map(|(frame_index, image)| Frame {
            name: format!("{}_{frame_index:04}", video.camera),
            split: if video.camera == HELD_OUT { Split::Test } else { Split::Train },
            image: image.clone(),
            mask: None,
            depth: None,
            lens: Lens::pinhole(camera.intrinsics),
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

/// The split rule, and every difference of the images from those of the literature.
fn split_rules(count: usize, reduction: u32) -> Vec<String> {
    let mut rules = vec!["camera 0 held out".to_owned()];
    if count != FRAMES {
        rules.push(format!("{count} frames"));
    }
    if reduction > 1 {
        rules.push(format!("images at 1/{reduction}"));
    }
    rules
}

/// Reads the point cloud of the first frame, which is not part of the data set itself.
fn points(dir: &Path, warnings: &mut Vec<String>) -> Result<Vec<([f64; 3], [u8; 3])>> {
    let Some(path) = POINTS.iter().map(|name| dir.join(name)).find(|path| path.is_file()) else {
        warnings.push(format!("{} is missing: initial points will be random", POINTS.join(" or ")));
        return Ok(Vec::new());
    };
    let cloud = PointCloud::read_ply(&path).map_err(|error| bad(error.message).at(&path))?;
    let positions = cloud.positions.into_iter().map(|position| position.map(f64::from));
    Ok(positions.zip(cloud.colors).collect())
}
