//! Points from the depth of the training frames, where it shares the gauge of the poses.

use rayon::prelude::*;
use scene::{Camera, ResizeFilter, Split, pixels};

use crate::cloud_file::Points;
use crate::error::{Result, bad};
use crate::pixels::read_mask;
use crate::source::Frame;

/// Approximate number of points: that of VGGT's own export to COLMAP.
const POINTS: f64 = 1e5;
/// Number of frames that are decoded: more of a long video add time, not coverage.
const FRAMES: usize = 250;

/// Back-projects the depth of the training frames, at most [`FRAMES`] of them, at a reduced size. Masked pixels move and give
/// no points.
pub(crate) fn points(frames: &[Frame]) -> Result<Points> {
    let train: Vec<&Frame> =
        frames.iter().filter(|frame| frame.split == Split::Train && frame.depth.is_some()).collect();
    let train: Vec<&Frame> = train.iter().copied().step_by(train.len().div_ceil(FRAMES).max(1)).collect();
    let share = (POINTS / train.len().max(1) as f64).max(1.0);
    let of_frame = train.par_iter().map(|frame| points_of(frame, share));
    Ok(of_frame.collect::<Result<Vec<_>>>()?.concat())
}

/// About `count` points of a frame, at most one per pixel.
fn points_of(frame: &Frame, count: f64) -> Result<Points> {
    let Some(depth) = &frame.depth else { return Ok(Points::new()) };
    let camera = frame.camera()?;
    let full = camera.intrinsics;
    let scale = (count / (f64::from(full.width) * f64::from(full.height))).sqrt().min(1.0);
    let side = |length: u32| (f64::from(length) * scale).round().max(1.0) as u32;
    let (width, height) = (side(full.width), side(full.height));
    let depth = depth.read(&frame.lens, &full, (width, height))?;
    let (image, _) = frame.composited([1.0; 3])?;
    let image = image.resized(width, height, ResizeFilter::Area).to_rgb8().map_err(|error| bad(error.message))?;
    let moving = frame.mask.as_deref().map(read_mask).transpose()?.map(|mask| mask.levels);
    let is_moving = |x: u32, y: u32| {
        moving.as_ref().is_some_and(|mask| mask.get_pixel(x * mask.width() / width, y * mask.height() / height)[0] != 0)
    };
    let camera: Camera = camera.resized(width, height);
    let world_from_camera = camera.camera_from_world.inverse();
    let point = |(at, center): (usize, glam::DVec2)| {
        let (z, x, y) = (f64::from(depth.depth_view[at]), at as u32 % width, at as u32 / width);
        let known = z > 0.0 && !is_moving(x, y);
        known.then(|| (world_from_camera.apply(camera.ray_view(center) * z).to_array(), image.get_pixel(x, y).0))
    };
    Ok(pixels::centers(width, height).enumerate().filter_map(point).collect())
}
