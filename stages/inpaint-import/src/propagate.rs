//! Filling what moves with what other views see behind it.

use glam::DVec3;
use scene::{Capture, DepthMap};

use crate::FilledView;
use crate::still::{SAME_DEPTH, StillView, median_color};

/// Cameras whose poses differ by less, relative to the scene, are one camera that stands still.
const SAME_POSE: f64 = 1e-6;
/// Points between what moves and a surface behind it at which others must see past.
const RAY_SAMPLES: usize = 64;
/// Samples that a surface needs where there are so many; single ones are edges of masks.
const MIN_SUPPORT: usize = 2;

/// A view with its moving pixels filled from `sources`, views at other times or from other places.
///
/// In this order: what the same camera pose sees at other times (median); the nearest surface at rest that other views
/// see on the pixel's ray with nothing unseen in front of it, in the median colour of the views that see it; the
/// background colour where other views see that the whole ray is empty. What remains is unfilled.
pub fn fill(target: &StillView, sources: &[StillView], capture: &Capture) -> FilledView {
    let pixels: Vec<usize> = (0..target.moving.inside.len()).filter(|at| target.moving.inside[*at]).collect();
    let mut filled = Filling::of(target, capture);
    let fixed: Vec<&StillView> = sources.iter().filter(|source| same_pose(source, target)).collect();
    for &pixel in &pixels {
        filled.try_fixed_camera(pixel, &fixed);
    }
    let surfaces = surfaces_behind(target, sources);
    for &pixel in &pixels {
        if filled.done[pixel] {
            continue;
        }
        let ray = Ray::of(target, pixel, sources);
        if !filled.try_surfaces(pixel, &surfaces[pixel], &ray) && ray.is_empty(capture.bounds_world) {
            filled.set(pixel, capture.background.map(scene::float_image::to_byte), 0.0);
        }
    }
    filled.finish(target)
}

/// A view while it is filled.
struct Filling {
    image: scene::image_file::RgbImage,
    depth: Option<Vec<f32>>,
    done: Vec<bool>,
}

impl Filling {
    /// The view with the background colour and no depth where something moves.
    fn of(target: &StillView, capture: &Capture) -> Self {
        let depth = target.depth.as_ref().map(|depth| depth.depth_view.clone());
        let mut filling = Self { image: target.image.clone(), depth, done: vec![true; target.moving.inside.len()] };
        let background = capture.background.map(scene::float_image::to_byte);
        for pixel in (0..filling.done.len()).filter(|pixel| target.moving.inside[*pixel]) {
            filling.set(pixel, background, 0.0);
            filling.done[pixel] = false;
        }
        filling
    }

    fn set(&mut self, pixel: usize, color: [u8; 3], depth_view: f64) {
        let width = self.image.width() as usize;
        self.image.get_pixel_mut((pixel % width) as u32, (pixel / width) as u32).0 = color;
        if let Some(depth) = &mut self.depth {
            depth[pixel] = depth_view as f32;
        }
        self.done[pixel] = true;
    }

    /// What a camera that stands still sees here when nothing moves in front.
    fn try_fixed_camera(&mut self, pixel: usize, fixed: &[&StillView]) {
        let still = || fixed.iter().filter(|source| !source.moving.inside[pixel]);
        let colors = still().map(|source| source.color(pixel).map(f64::from)).collect();
        let mut depths: Vec<f64> = still().filter_map(|source| source.still_depth(pixel)).collect();
        depths.sort_by(f64::total_cmp);
        let depth_view = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
        if let Some(color) = median_color(colors) {
            self.set(pixel, color, depth_view);
        }
    }

    /// The colour in which others see the nearest of these surfaces that nothing unseen can hide; whether there is one.
    /// What a view sees between its pixels is preferred; at the edge of a surface only single pixels show it.
    fn try_surfaces(&mut self, pixel: usize, depths: &[f64], ray: &Ray) -> bool {
        let color = |depth_view: f64| {
            let point_world = ray.at(depth_view);
            let smooth = ray.sources.iter().filter_map(|source| source.color_of(point_world)).collect();
            let single = || ray.sources.iter().filter_map(|source| source.pixel_color_of(point_world)).collect();
            median_color(smooth).or_else(|| median_color(single()))
        };
        let reached = depths.iter().filter(|depth_view| ray.is_clear_until(**depth_view * (1.0 - 2.0 * SAME_DEPTH)));
        let found = reached.map(|depth_view| (color(*depth_view), *depth_view)).find(|found| found.0.is_some());
        if let Some((Some(color), depth_view)) = found {
            self.set(pixel, color, depth_view);
        }
        found.is_some()
    }

    fn finish(self, target: &StillView) -> FilledView {
        let (width, height) = (self.image.width(), self.image.height());
        let moving = &target.moving;
        let inside = self.done.iter().map(|done| !done).collect();
        let unfilled = layer_split::Mask { width: moving.width, height: moving.height, inside }.to_labels();
        let depth = self.depth.map(|depth_view| DepthMap { width, height, depth_view });
        FilledView { image: self.image, depth, unfilled }
    }
}

/// Per moving pixel the depths of the surfaces at rest that other views see on its ray behind what moves, nearest first.
fn surfaces_behind(target: &StillView, sources: &[StillView]) -> Vec<Vec<f64>> {
    let mut candidates: Vec<Vec<f32>> = vec![Vec::new(); target.moving.inside.len()];
    let (width, height) = (target.camera.intrinsics.width, target.camera.intrinsics.height);
    for source in sources {
        for pixel in 0..source.moving.inside.len() {
            let Some(depth_view) = source.still_depth(pixel) else { continue };
            let Some((place, z)) = target.camera.project(point_world(source, pixel, depth_view)) else { continue };
            // The four pixels whose centres lie around the point.
            let (x, y) = ((place.x - 0.5).floor(), (place.y - 0.5).floor());
            for (x, y) in [(x, y), (x + 1.0, y), (x, y + 1.0), (x + 1.0, y + 1.0)] {
                let inside = x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height);
                let at = y.max(0.0) as usize * width as usize + x.max(0.0) as usize;
                if inside && target.moving.inside[at] && is_behind(target, at, z) {
                    candidates[at].push(z as f32);
                }
            }
        }
    }
    candidates.into_iter().map(supported).collect()
}

/// Whether a surface at depth `z` can be hidden by what moves in a pixel.
fn is_behind(target: &StillView, pixel: usize, z: f64) -> bool {
    let in_front = target.depth.as_ref().map_or(0.0, |depth| f64::from(depth.depth_view[pixel]));
    z >= in_front * (1.0 - SAME_DEPTH)
}

/// The mean depth of each group that agrees, where enough do, nearest first.
fn supported(mut depths: Vec<f32>) -> Vec<f64> {
    depths.sort_by(f32::total_cmp);
    let needed = MIN_SUPPORT.min(depths.len());
    let mut means = Vec::new();
    let mut rest = depths.as_slice();
    while let Some(nearest) = rest.first() {
        let limit = nearest * (1.0 + SAME_DEPTH as f32);
        let (group, farther) = rest.split_at(rest.partition_point(|depth| *depth <= limit));
        if group.len() >= needed {
            means.push(group.iter().map(|depth| f64::from(*depth)).sum::<f64>() / group.len() as f64);
        }
        rest = farther;
    }
    means
}

/// The ray of a moving pixel, from what moves onwards, and the views that may see along it.
struct Ray<'a> {
    origin_world: DVec3,
    /// Scaled to view-space z = 1, so that distances are depths.
    direction_world: DVec3,
    /// Depth of what moves: in front of it nothing is.
    start: f64,
    sources: &'a [StillView],
}

impl<'a> Ray<'a> {
    fn of(target: &StillView, pixel: usize, sources: &'a [StillView]) -> Self {
        let origin_world = target.camera.position_world();
        let start = target.depth.as_ref().map_or(0.0, |depth| f64::from(depth.depth_view[pixel]));
        Self { origin_world, direction_world: point_world(target, pixel, 1.0) - origin_world, start, sources }
    }

    fn at(&self, depth_view: f64) -> DVec3 {
        self.origin_world + depth_view * self.direction_world
    }

    /// Whether other views see past every point between what moves and this depth.
    fn is_clear_until(&self, depth_view: f64) -> bool {
        self.is_clear([self.start, depth_view])
    }

    /// Whether other views see that there is nothing behind what moves within the bounds of the scene.
    fn is_empty(&self, bounds_world: Option<[[f64; 3]; 2]>) -> bool {
        let Some(bounds) = bounds_world.filter(|_| self.sources.iter().any(StillView::knows_emptiness)) else {
            return false;
        };
        let crossing = crossing(self.origin_world, self.direction_world, bounds);
        crossing.is_none_or(|[near, far]| self.is_clear([near.max(self.start), far]))
    }

    fn is_clear(&self, [near, far]: [f64; 2]) -> bool {
        let depth = |at: usize| near + (far - near) * (at as f64 + 0.5) / RAY_SAMPLES as f64;
        let is_seen_past = |point: DVec3| self.sources.iter().any(|source| source.sees_past(point));
        near >= far || (0..RAY_SAMPLES).all(|at| is_seen_past(self.at(depth(at))))
    }
}

/// Where a ray enters and leaves a box, in units of its direction.
fn crossing(origin: DVec3, direction: DVec3, [low, high]: [[f64; 3]; 2]) -> Option<[f64; 2]> {
    let (a, b) = ((DVec3::from(low) - origin) / direction, (DVec3::from(high) - origin) / direction);
    let near = a.min(b).max_element().max(0.0);
    let far = a.max(b).min_element();
    (near < far).then_some([near, far])
}

fn point_world(view: &StillView, pixel: usize, depth_view: f64) -> DVec3 {
    view.camera.camera_from_world.inverse().apply(view.camera.ray_view(view.center(pixel)) * depth_view)
}

fn same_pose(a: &StillView, b: &StillView) -> bool {
    let (from_a, from_b) = (a.camera.camera_from_world, b.camera.camera_from_world);
    let scale = 1.0 + from_a.translation.length();
    a.camera.intrinsics == b.camera.intrinsics
        && from_a.translation.distance(from_b.translation) <= SAME_POSE * scale
        && (from_a.rotation - from_b.rotation).to_cols_array().iter().all(|value| value.abs() <= SAME_POSE)
}
