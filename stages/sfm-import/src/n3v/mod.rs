//! Neural 3D Video (Li et al. 2022), also called DyNeRF or Plenoptic Video: a rig of fixed cameras. Each camera has a row in
//! `poses_bounds.npy` and a video `camNN.mp4`, or its extracted frames in `camNN/images` or `camNN`.
//!
//! Rows correspond to cameras in the order of their names. `cam00` is the test camera; all others are for training.

pub(crate) mod cameras;

use std::path::Path;

pub(crate) use self::cameras::camera_names;
use crate::cloud_file::CloudSource;
use crate::error::Result;
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::poses_bounds::{self, Stated};
use crate::rig::{self, RigCamera, Video, videos};
use crate::source::{Frame, SourceCapture};

/// The test camera, at the centre of the rig.
const HELD_OUT: &str = "cam00";
/// Number of frames that published numbers are measured on: all frames of a scene, or the first of flame_salmon's 1200.
const FRAMES: u32 = 300;
/// File names of the point cloud of the first frame, in world coordinates of the poses, as in loaders derived from
/// 4DGaussians. It is not part of the data set itself.
const POINTS: [&str; 2] = ["points3D_downsample2.ply", "points3D.ply"];
/// A flaw of the benchmark.
const UNSYNCHRONISED: &str =
    "N3V's coffee_martini: cam13 is badly synchronised; published tables keep it, omit it, or omit the scene";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(poses_bounds::FILE).is_file() && !camera_names(dir).is_empty()
}

/// Reads the poses and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let mut videos = cameras::read(dir)?;
    let names: Vec<String> = videos.iter().map(|video| video.camera.clone()).collect();
    if dir.ends_with("coffee_martini") && names.iter().any(|name| name == "cam13") {
        warnings.push(UNSYNCHRONISED.into());
    }
    let stated_in = dir.join(poses_bounds::FILE);
    let stated = poses_bounds::read(&stated_in, &names)?;
    let usual = names.iter().find(|name| *name == HELD_OUT).unwrap_or(&names[0]);
    if usual != HELD_OUT && params.test_cameras.is_empty() {
        warnings.push(format!("there is no {HELD_OUT}: {usual} is the test camera; test_cameras names others"));
    }
    warnings.extend(poses_bounds::order_warning(&names));
    let reduction = poses_bounds::reduction(videos[0].size()?, &stated[0].camera);
    videos::check_rates(&videos, params.fps, &mut warnings);
    videos::select(&mut videos, params, Some(FRAMES), &mut warnings)?;
    let count = videos[0].frames.len();
    let cameras = rig_cameras(videos, &stated, reduction);
    let mut frames = rig::frames(&cameras, &stated_in, params.fps);
    let rule = hold_out(&mut frames, &cameras, usual, params)?;
    let cloud = match rig::cloud(POINTS.map(|name| dir.join(name))) {
        CloudSource::Sweep(_) => CloudSource::Sweep(depth_range(&stated)),
        file => file,
    };
    let rules = split_rules(rule, count, reduction);
    let capture = rig::capture(dir, (Format::N3v, "n3v"), frames, rules, params);
    Ok(SourceCapture { wants_test: true, cloud: Some(cloud), warnings, ..capture })
}

/// The cameras at the size of their frames, which is 1/`reduction` of the stated one.
fn rig_cameras(videos: Vec<Video>, stated: &[Stated], reduction: u32) -> Vec<RigCamera> {
    let camera = |(video, stated): (Video, &Stated)| {
        let camera = poses_bounds::reduced(&stated.camera, reduction);
        let lens = Lens::pinhole(camera.intrinsics);
        RigCamera { video, lens, camera_from_world: camera.camera_from_world, masks: Vec::new() }
    };
    videos.into_iter().zip(stated).map(camera).collect()
}

/// Holds out the usual camera, or those that the parameters name.
fn hold_out(frames: &mut [Frame], cameras: &[RigCamera], usual: &str, params: &Params) -> Result<String> {
    if !params.test_cameras.is_empty() {
        return rig::hold_out(frames, cameras, &params.test_cameras, params);
    }
    let rule = rig::hold_out(frames, cameras, &[usual.into()], params)?;
    Ok(if usual == HELD_OUT { "camera 0 held out".into() } else { rule })
}

/// The split rule, and every difference of the images from those of the literature.
fn split_rules(held_out: String, count: usize, reduction: u32) -> Vec<String> {
    let mut rules = vec![held_out];
    if count != FRAMES as usize {
        rules.push(format!("{count} frames"));
    }
    if reduction > 1 {
        rules.push(format!("images at 1/{reduction}"));
    }
    rules
}

/// The depths of all cameras' nearest and farthest points.
fn depth_range(stated: &[Stated]) -> Option<[f64; 2]> {
    let ranges = stated.iter().filter_map(|row| row.depth_view);
    ranges.reduce(|[near, far], [nearer, farther]| [near.min(nearer), far.max(farther)])
}
