//! Fills moving pixels with the static scene behind them, as seen by other views.

use glam::DVec3;
use scene::float_image::to_byte;
use scene::image_file::RgbImage;
use scene::statistics::median;
use scene::{Capture, DepthMap, Mask};

use crate::FilledView;
use crate::static_view::{SAME_DEPTH, StaticView, median_color};

/// Largest difference of two poses of one static camera, relative to the scale of the coordinates.
const SAME_POSE: f64 = 1e-6;
/// Number of points on a ray, between the moving surface and the surface behind it, that other views must see past.
const RAY_SAMPLES: usize = 64;
/// Minimum number of samples of a surface, if the pixel has this many: a single sample is often the edge of a mask.
const MIN_SUPPORT: usize = 2;

/// Fills the moving pixels of `target` from `sources`, views at other times or from other places.
///
/// Tried in this order: (1) the median of what the same camera pose shows at other times; (2) the nearest static
/// surface that other views see on the ray of the pixel, in their median colour, if they also see past every point in
/// front of it; (3) the background colour, if other views see that the whole ray is empty. Remaining pixels are
/// unfilled.
pub(crate) fn fill(target: &StaticView, sources: &[StaticView], capture: &Capture) -> FilledView {
    let pixels: Vec<usize> = (0..target.moving.inside.len()).filter(|at| target.moving.inside[*at]).collect();
    let mut filled = Filling::of(target, capture);
    let fixed: Vec<&StaticView> = sources.iter().filter(|source| same_pose(source, target)).collect();
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
            filled.set(pixel, capture.background.map(to_byte), 0.0);
        }
    }
    filled.finish(target)
}

/// The state of a view while it is filled.
struct Filling {
    image: RgbImage,
    depth: Option<Vec<f32>>,
    /// Whether a pixel is static or filled.
    done: Vec<bool>,
}

impl Filling {
    /// The view with the background colour and depth 0 where something moves.
    fn of(target: &StaticView, capture: &Capture) -> Self {
        let depth = target.depth.as_ref().map(|depth| depth.depth_view.clone());
        let mut filling = Self { image: target.image.clone(), depth, done: vec![true; target.moving.inside.len()] };
        let background = capture.background.map(to_byte);
        for pixel in (0..filling.done.len()).filter(|pixel| target.moving.inside[*pixel]) {
            filling.set(pixel, background, 0.0);
            filling.done[pixel] = false;
        }
        filling
    }

    /// Fills a pixel.
    fn set(&mut self, pixel: usize, color: [u8; 3], depth_view: f64) {
        let width = self.image.width() as usize;
        self.image.get_pixel_mut((pixel % width) as u32, (pixel / width) as u32).0 = color;
        if let Some(depth) = &mut self.depth {
            depth[pixel] = depth_view as f32;
        }
        self.done[pixel] = true;
    }

    /// Fills a pixel with the median colour that a static camera shows there at times when nothing moves in front.
    fn try_fixed_camera(&mut self, pixel: usize, fixed: &[&StaticView]) {
        let unoccluded = || fixed.iter().filter(|source| !source.moving.inside[pixel]);
        let colors = unoccluded().map(|source| source.color(pixel).map(f64::from)).collect();
        let depth_view = median(unoccluded().filter_map(|source| source.static_depth(pixel))).unwrap_or(0.0);
        if let Some(color) = median_color(colors) {
            self.set(pixel, color, depth_view);
        }
    }

    /// Fills a pixel with the nearest of the candidate surfaces that no unseen object can hide, and returns whether one
    /// exists. Interpolated colours are preferred; at the edge of a surface, only single pixels show it.
    fn try_surfaces(&mut self, pixel: usize, depths: &[f64], ray: &Ray) -> bool {
        let color = |depth_view: f64| {
            let point_world = ray.at(depth_view);
            let interpolated = ray.sources.iter().filter_map(|source| source.color_of(point_world)).collect();
            let single = || ray.sources.iter().filter_map(|source| source.pixel_color_of(point_world)).collect();
            median_color(interpolated).or_else(|| median_color(single()))
        };
        let reached = depths.iter().filter(|depth_view| ray.is_clear_until(**depth_view * (1.0 - 2.0 * SAME_DEPTH)));
        let found = reached.map(|depth_view| (color(*depth_view), *depth_view)).find(|found| found.0.is_some());
        if let Some((Some(color), depth_view)) = found {
            self.set(pixel, color, depth_view);
        }
        found.is_some()
    }

    /// The filled view, with a mask of the pixels that no source could fill.
    fn finish(self, target: &StaticView) -> FilledView {
        let (width, height) = (self.image.width(), self.image.height());
        let moving = &target.moving;
        let inside = self.done.iter().map(|done| !done).collect();
        let unfilled = Mask { width: moving.width, height: moving.height, inside }.to_labels();
        let depth = self.depth.map(|depth_view| DepthMap { width, height, depth_view });
        FilledView { image: self.image, depth, unfilled }
    }
}

/// For every moving pixel, the depths of static surfaces that other views see on its ray behind the moving surface,
/// nearest first.
fn surfaces_behind(target: &StaticView, sources: &[StaticView]) -> Vec<Vec<f64>> {
    let mut candidates: Vec<Vec<f32>> = vec![Vec::new(); target.moving.inside.len()];
    let (width, height) = (target.camera.intrinsics.width, target.camera.intrinsics.height);
    for source in sources {
        for pixel in 0..source.moving.inside.len() {
            let Some(depth_view) = source.static_depth(pixel) else { continue };
            let Some((place, z)) = target.camera.project(point_world(source, pixel, depth_view)) else { continue };
            // The four pixels whose centres surround the point.
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

/// Whether a surface at depth `z` is behind the moving surface of a pixel.
fn is_behind(target: &StaticView, pixel: usize, z: f64) -> bool {
    let in_front = target.depth.as_ref().map_or(0.0, |depth| f64::from(depth.depth_view[pixel]));
    z >= in_front * (1.0 - SAME_DEPTH)
}

/// Clusters depths and returns the mean of every cluster with enough samples, nearest first.
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

/// The ray of a moving pixel behind the moving surface, and the views that may see points on it.
struct Ray<'a> {
    origin_world: DVec3,
    /// Direction, scaled to view-space z = 1, so that distances along it are depths.
    direction_world: DVec3,
    /// Depth of the moving surface; there is nothing in front of it.
    start: f64,
    sources: &'a [StaticView],
}

impl<'a> Ray<'a> {
    /// The ray through the centre of a pixel.
    fn of(target: &StaticView, pixel: usize, sources: &'a [StaticView]) -> Self {
        let origin_world = target.camera.position_world();
        let start = target.depth.as_ref().map_or(0.0, |depth| f64::from(depth.depth_view[pixel]));
        Self { origin_world, direction_world: point_world(target, pixel, 1.0) - origin_world, start, sources }
    }

    /// The world point at a depth.
    fn at(&self, depth_view: f64) -> DVec3 {
        self.origin_world + depth_view * self.direction_world
    }

    /// Whether other views see past every point between the moving surface and this depth.
    fn is_clear_until(&self, depth_view: f64) -> bool {
        self.is_clear([self.start, depth_view])
    }

    /// Whether other views show that the ray is empty behind the moving surface, within the bounds of the scene.
    fn is_empty(&self, bounds_world: Option<[[f64; 3]; 2]>) -> bool {
        let Some(bounds) = bounds_world.filter(|_| self.sources.iter().any(StaticView::knows_emptiness)) else {
            return false;
        };
        let crossing = crossing(self.origin_world, self.direction_world, bounds);
        crossing.is_none_or(|[near, far]| self.is_clear([near.max(self.start), far]))
    }

    /// Whether other views see past every sampled point between two depths.
    fn is_clear(&self, [near, far]: [f64; 2]) -> bool {
        let depth = |at: usize| near + (far - near) * (at as f64 + 0.5) / RAY_SAMPLES as f64;
        let is_seen_past = |point: DVec3| self.sources.iter().any(|source| source.sees_past(point));
        near >= far || (0..RAY_SAMPLES).all(|at| is_seen_past(self.at(depth(at))))
    }
}

/// The parameters at which a ray enters and leaves a box, in units of its direction; `None` if it misses the box.
fn crossing(origin: DVec3, direction: DVec3, [low, high]: [[f64; 3]; 2]) -> Option<[f64; 2]> {
    let (a, b) = ((DVec3::from(low) - origin) / direction, (DVec3::from(high) - origin) / direction);
    let near = a.min(b).max_element().max(0.0);
    let far = a.max(b).min_element();
    (near < far).then_some([near, far])
}

/// The world point at a depth behind the centre of a pixel.
fn point_world(view: &StaticView, pixel: usize, depth_view: f64) -> DVec3 {
    view.camera.unproject(view.center(pixel), depth_view)
}

/// Whether two views are taken by one static camera.
fn same_pose(a: &StaticView, b: &StaticView) -> bool {
    let (from_a, from_b) = (a.camera.camera_from_world, b.camera.camera_from_world);
    let scale = 1.0 + from_a.translation.length();
    a.camera.intrinsics == b.camera.intrinsics
        && from_a.translation.distance(from_b.translation) <= SAME_POSE * scale
        && (from_a.rotation - from_b.rotation).to_cols_array().iter().all(|value| value.abs() <= SAME_POSE)
}
