//! Neural 3D Video (Li et al. 2022), also called DyNeRF or Plenoptic Video: a rig of cameras that stand still, with a row
//! of `poses_bounds.npy` and a video each, whose frames lie in `camNN/images` or `camNN`.
//!
//! Rows pair with cameras in the order of their names. The first camera is tested on and all others are trained on.

mod poses;
pub(crate) mod videos;

use std::path::Path;

use scene::{Camera, PointCloud, Split, TimeMap};

use self::videos::Video;
pub use self::videos::camera_names;
use crate::Params;
use crate::lens::Lens;
use crate::params::Format;
use crate::source::{Frame, Result, SourceCapture, bad, image_size};
use crate::split;

/// The camera that is tested on, the central one of the rig.
const HELD_OUT: &str = "cam00";
/// Frames that published numbers are measured on: all of a scene, or the first of flame_salmon's 1200.
const FRAMES: usize = 300;
/// Clouds of the first frame as loaders in the tradition of 4DGaussians look for them, in the world of the poses.
const POINTS: [&str; 2] = ["points3D_downsample2.ply", "points3D.ply"];
/// A flaw of the benchmark.
const UNSYNCHRONISED: &str =
    "N3V's coffee_martini: cam13 is badly synchronised; published tables keep it, leave it out, or leave out the scene";

/// Whether `dir` holds this format.
pub fn is_here(dir: &Path) -> bool {
    dir.join(poses::FILE).is_file() && !camera_names(dir).is_empty()
}

/// Reads the poses and the names of the frames, without opening an image beyond its header.
pub fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let mut videos = videos::read(dir)?;
    let names: Vec<&str> = videos.iter().map(|video| video.camera.as_str()).collect();
    if !names.contains(&HELD_OUT) {
        let message = format!("no camera {HELD_OUT}, which is the one that is tested on (found {})", names.join(", "));
        return Err(bad(message).at(dir));
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
    let mut rules = split_rules(count, reduction);
    rules.extend(split::refine(&mut frames, params));
    Ok(SourceCapture {
        name: dir.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        format: Format::N3v,
        dataset: "n3v",
        wants_test: true,
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "index / (count - 1)".into() },
        time_map: time_map(count, is_static, params),
        frames,
        points: points(dir, &mut warnings)?,
        bounds_world: None,
        quality: None,
        warnings,
    })
}

/// How many times smaller the images are than the videos that the poses are for. 1 where they are no whole fraction of
/// them: each image is then found to have the wrong size.
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

/// Leaves the frames that published numbers are measured on; how many there are.
fn keep_first(videos: &mut [Video], warnings: &mut Vec<String>) -> usize {
    let found = videos[0].frames.len();
    if found > FRAMES {
        warnings.push(format!("the first {FRAMES} of {found} frames are used, as in the literature"));
        videos.iter_mut().for_each(|video| video.frames.truncate(FRAMES));
    }
    found.min(FRAMES)
}

/// All frames in order of time, then camera.
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

/// What made the split, and whatever keeps the images from being those of the literature.
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

fn time_map(count: usize, is_static: bool, params: &Params) -> TimeMap {
    if is_static {
        return TimeMap { start_secs: 0.0, end_secs: 0.0, frame_secs: 1.0 };
    }
    TimeMap { start_secs: 0.0, end_secs: (count - 1) as f64 / params.fps, frame_secs: 1.0 / params.fps }
}

/// The cloud of the first frame; the data set itself has none.
fn points(dir: &Path, warnings: &mut Vec<String>) -> Result<Vec<([f64; 3], [u8; 3])>> {
    let Some(path) = POINTS.iter().map(|name| dir.join(name)).find(|path| path.is_file()) else {
        warnings.push(format!("no {}: initial points will be random", POINTS.join(" or ")));
        return Ok(Vec::new());
    };
    let cloud = PointCloud::read_ply(&path).map_err(|error| bad(error.message).at(&path))?;
    let positions = cloud.positions.into_iter().map(|position| position.map(f64::from));
    Ok(positions.zip(cloud.colors).collect())
}
