//! Points of the first instant, found in the training views of a rig with known poses.
//!
//! A plane sweep (Collins 1996): a textured patch of one view is compared at many depths with its neighbours by
//! normalised cross-correlation. A depth is accepted if it stands out, and if a search in the neighbours, around the
//! projection of the point, finds the patch at this projection. Test views are never used.

mod sweep;
mod view;

use std::collections::BTreeMap;
use std::sync::Mutex;

use glam::DVec2;
use rayon::prelude::*;
use scene::camera::common_view_volume;
use scene::float_image::ResizeFilter;
use scene::statistics::median;
use scene::{Camera, Split};
use serde::Serialize;

use self::sweep::{Found, point};
use self::view::{HALF, View};
use crate::cloud_file::Points;
use crate::error::bad;
use crate::frame_image::for_each_image;
use crate::pixels;
use crate::source::Frame;

/// Width of the images that are matched: published clouds of Neural 3D Video have a point every few pixels of it.
const WIDTH: u32 = 480;
/// Distance between tried pixels.
const STEP: u32 = 4;
/// Maximum number of matched views: more of them add no information, and cost time and memory.
const VIEWS: usize = 48;
/// Neighbours that a patch is compared with.
const NEIGHBOURS: usize = 4;
/// Largest angle between the axes of neighbours, beyond which patches are too distorted.
const MAX_ANGLE_DEGREES: f64 = 50.0;

/// The triangulated points, and their quality.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Triangulation {
    /// Number of points.
    pub(crate) points: usize,
    /// Number of training views.
    pub(crate) views: usize,
    /// Mean distance between the projections of a point and the matches of its patch, in pixels of the stored images.
    pub(crate) reprojection_px: f64,
}

/// Points on which several training views of the first instant agree, between these view-space depths if stated. `None`
/// for fewer than three views. `on_view` is called with the number of searched views and of all views; its error ends the
/// search.
pub(crate) fn triangulate(
    frames: &[Frame],
    depth_view: Option<[f64; 2]>,
    on_view: &dyn Fn(usize, usize) -> anyhow::Result<()>,
) -> anyhow::Result<Option<(Points, Triangulation)>> {
    let frames = first_instant(frames);
    if frames.len() < 3 {
        return Ok(None);
    }
    let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera()).collect::<Result<_, _>>()?;
    let views = views(&frames, &cameras, depth_view)?;
    let mut found: Vec<Found> = Vec::new();
    for (searched, view) in views.iter().enumerate() {
        on_view(searched, views.len())?;
        let neighbours = neighbours(view, &views);
        let pixels: Vec<DVec2> = tried(view).collect();
        let search = |pixel| point(view, &neighbours, pixel, f64::from(STEP));
        found.par_extend(pixels.into_par_iter().filter_map(search));
    }
    let kept = thinned(found);
    let scale = f64::from(cameras[0].intrinsics.width) / f64::from(views[0].width());
    let mean_px = kept.iter().map(|found| found.error_px).sum::<f64>() / kept.len().max(1) as f64;
    let summary = Triangulation { points: kept.len(), views: views.len(), reprojection_px: mean_px * scale };
    Ok(Some((kept.iter().map(|found| (found.position.to_array(), found.color)).collect(), summary)))
}

/// The training frames of the first instant that has any; an even selection if there are very many.
fn first_instant(frames: &[Frame]) -> Vec<&Frame> {
    let train: Vec<&Frame> = frames.iter().filter(|frame| frame.split == Split::Train).collect();
    let first = train.iter().map(|frame| frame.frame_index).min();
    let shown: Vec<&Frame> = train.into_iter().filter(|frame| Some(frame.frame_index) == first).collect();
    let step = shown.len().div_ceil(VIEWS).max(1);
    shown.into_iter().step_by(step).collect()
}

/// The views at the matched size, in the order of their frames.
fn views(frames: &[&Frame], cameras: &[Camera], depth_view: Option<[f64; 2]>) -> anyhow::Result<Vec<View>> {
    let views = Mutex::new(BTreeMap::new());
    for_each_image(frames, |frame, image| {
        let camera = frame.camera()?;
        let (image, _) = pixels::composited(image, [1.0; 3])?;
        let image = pixels::undistorted(image, &frame.lens, &camera.intrinsics);
        let width = WIDTH.min(image.width);
        let height = (f64::from(image.height) * f64::from(width) / f64::from(image.width)).round().max(1.0) as u32;
        let depth_view = depth_view.unwrap_or_else(|| depth_range(&camera, cameras));
        let view =
            View::new(camera.resized(width, height), image.resized(width, height, ResizeFilter::Area), depth_view);
        views.lock().map_err(|_| bad("another view failed"))?.insert(frame.name.clone(), view);
        Ok(())
    })?;
    Ok(views.into_inner().map_err(|_| bad("a view failed"))?.into_values().collect())
}

/// The range of depths around the common view volume of all cameras: from two radii in front of its centre to four behind it.
fn depth_range(camera: &Camera, cameras: &[Camera]) -> [f64; 2] {
    let Some(ball) = common_view_volume(cameras) else { return [0.1, 100.0] };
    let depth = camera.camera_from_world.apply(ball.center_world).z.max(ball.radius);
    [(depth - 2.0 * ball.radius).max(0.15 * depth), depth + 4.0 * ball.radius]
}

/// The pixels that are tried.
fn tried(view: &View) -> impl Iterator<Item = DVec2> {
    let border = HALF as u32 + 1;
    let along = move |side: u32| (border..side.saturating_sub(border)).step_by(STEP as usize);
    let pixel = |column: u32, row: u32| DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
    let (width, height) = (view.width(), view.height());
    along(height).flat_map(move |row| along(width).map(move |column| pixel(column, row)))
}

/// The nearest other views that look in a similar direction.
fn neighbours<'a>(view: &View, views: &'a [View]) -> Vec<&'a View> {
    let distance = |other: &&View| other.camera.position_world().distance(view.camera.position_world());
    let is_similar = |other: &&View| {
        let angle = view.axis_world().angle_between(other.axis_world()).to_degrees();
        distance(other) > 0.0 && angle <= MAX_ANGLE_DEGREES
    };
    let mut near: Vec<&View> = views.iter().filter(is_similar).collect();
    near.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    near.truncate(NEIGHBOURS);
    near
}

/// The best point of each cell of a grid with the spacing of the points.
fn thinned(found: Vec<Found>) -> Vec<Found> {
    let Some(cell) = median(found.iter().map(|found| found.spacing)) else { return found };
    let mut best: BTreeMap<[i64; 3], Found> = BTreeMap::new();
    for found in found {
        let key = (found.position / cell).floor().to_array().map(|value| value as i64);
        if best.get(&key).is_none_or(|other| other.score < found.score) {
            best.insert(key, found);
        }
    }
    best.into_values().collect()
}
