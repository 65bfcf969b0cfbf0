//! The part of space in the common view of a set of cameras.

use glam::{DMat3, DVec3};

use super::Camera;
use crate::statistics::median;

/// Smallest mean sin² of the angles between optical axes and the direction in which they agree best, below which the
/// axes count as parallel (2°) and have no usable point of convergence.
const PARALLEL: f64 = 1.2e-3;
/// Distance of the assumed scene from parallel cameras, in distances between the outermost cameras.
const PARALLEL_DEPTH: f64 = 5.0;
/// Depth of the assumed scene of a single camera, and of cameras at one place, in scene units.
const LONE_DEPTH: f64 = 4.0;

/// Radius of a set of points, relative to their distance from the origin, below which the points differ only by rounding.
const SAME_PLACE: f64 = 1e-6;
/// Such a radius at the origin, scene units: far below the size of any scene, even one of a micrometre in metres.
const SAME_PLACE_AT_ORIGIN: f64 = 1e-9;

/// A ball in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// The centre.
    pub center_world: DVec3,
    /// The radius in scene units.
    pub radius: f64,
}

impl Ball {
    /// The smallest axis-aligned box around the ball: its least and greatest corner.
    pub fn bounds_world(&self) -> [[f64; 3]; 2] {
        [(self.center_world - self.radius).to_array(), (self.center_world + self.radius).to_array()]
    }
}

/// The ball around the point of convergence of the cameras that half of the cameras see in full; `None` without cameras.
///
/// The centre is the point with the least sum of squared distances from the optical axes, Σ (I − d dᵀ)(p − o) = 0. A
/// camera sees the ball of radius r in full if every side plane of its frustum is at least r away from the centre; the
/// radius is the median of these distances. On D-NeRF's hemispheres (distance 4, field of view 39.6°) it is 1.36, where
/// loaders of that data set assume a cube of ±1.3. If the axes are parallel or diverge, the centre lies in front of the
/// mean camera, five times as far as the outermost cameras are apart.
pub fn common_view_volume(cameras: &[Camera]) -> Option<Ball> {
    let axes: Vec<Axis> = cameras.iter().map(Axis::of).collect();
    let count = (!axes.is_empty()).then_some(axes.len() as f64)?;
    let origins: Vec<DVec3> = axes.iter().map(|axis| axis.origin).collect();
    let origin = origins.iter().sum::<DVec3>() / count;
    let ahead = axes.iter().map(|axis| axis.direction).sum::<DVec3>() / count;
    let radius = spread(&origins);
    let convergence = radius.and_then(|_| convergence(&axes, origin));
    let center_world = convergence.unwrap_or_else(|| {
        let depth = radius.map_or(LONE_DEPTH, |radius| PARALLEL_DEPTH * 2.0 * radius);
        origin + depth * ahead.normalize_or(axes[0].direction)
    });
    let radius = median(cameras.iter().map(|camera| clearance(camera, center_world)))?;
    // Cameras that look outwards see no common ball; their surroundings are assumed to be as large as the distances between them.
    let farthest = axes.iter().map(|axis| axis.origin.distance(center_world)).fold(0.0, f64::max);
    let radius = match radius {
        seen if seen > 0.0 => seen,
        _ if farthest > 0.0 => farthest,
        _ => LONE_DEPTH,
    };
    Some(Ball { center_world, radius })
}

/// The largest distance of a point from the mean of all; `None` if the points differ only by rounding, or without points.
pub(crate) fn spread(points_world: &[DVec3]) -> Option<f64> {
    let mean = points_world.iter().sum::<DVec3>() / points_world.len().max(1) as f64;
    let radius = points_world.iter().map(|point| point.distance(mean)).fold(0.0, f64::max);
    (radius > SAME_PLACE_AT_ORIGIN.max(SAME_PLACE * mean.length())).then_some(radius)
}

/// An optical axis.
struct Axis {
    origin: DVec3,
    direction: DVec3,
}

impl Axis {
    fn of(camera: &Camera) -> Self {
        let world_from_camera = camera.camera_from_world.inverse();
        Self { origin: world_from_camera.translation, direction: world_from_camera.rotation * DVec3::Z }
    }
}

/// The share of the cameras that have the point of convergence of all cameras behind them; `None` if the axes are parallel, or if the
/// cameras are at one place.
pub fn share_facing_away(cameras: &[Camera]) -> Option<f64> {
    let axes: Vec<Axis> = cameras.iter().map(Axis::of).collect();
    let origins: Vec<DVec3> = axes.iter().map(|axis| axis.origin).collect();
    spread(&origins)?;
    let point = meeting_point(&axes, origins.iter().sum::<DVec3>() / origins.len() as f64)?;
    Some(1.0 - share_ahead(&axes, point))
}

/// The share of the axes that have a point in front of them.
fn share_ahead(axes: &[Axis], point: DVec3) -> f64 {
    let ahead = axes.iter().filter(|axis| axis.direction.dot(point - axis.origin) > 0.0).count();
    ahead as f64 / axes.len() as f64
}

/// The point nearest to all axes, if they are not parallel and most cameras have it in front of them.
fn convergence(axes: &[Axis], origin: DVec3) -> Option<DVec3> {
    meeting_point(axes, origin).filter(|point| share_ahead(axes, *point) > 0.5)
}

/// The point nearest to all axes, if they are not parallel.
fn meeting_point(axes: &[Axis], origin: DVec3) -> Option<DVec3> {
    let (mut across, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for Axis { origin: at, direction } in axes {
        let beside = DMat3::IDENTITY
            - DMat3::from_cols(*direction * direction.x, *direction * direction.y, *direction * direction.z);
        across += beside;
        right += beside * (*at - origin);
    }
    let inverse = across.inverse();
    // The greatest eigenvalue of the inverse lies between its mean diagonal entry and three times that.
    let least_eigenvalue = 1.0 / (inverse.x_axis.x + inverse.y_axis.y + inverse.z_axis.z);
    if !least_eigenvalue.is_finite() || least_eigenvalue < PARALLEL * axes.len() as f64 {
        return None;
    }
    Some(origin + inverse * right)
}

/// The least distance of a point from the side planes of a camera's frustum; negative outside the frustum.
fn clearance(camera: &Camera, point_world: DVec3) -> f64 {
    let at = camera.camera_from_world.apply(point_world);
    let lens = &camera.intrinsics;
    let plane = |slope: f64, offset: f64| (slope * at.z + offset) / slope.hypot(1.0);
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let sides = [
        plane(lens.center_x / lens.focal_x, at.x),
        plane((width - lens.center_x) / lens.focal_x, -at.x),
        plane(lens.center_y / lens.focal_y, at.y),
        plane((height - lens.center_y) / lens.focal_y, -at.y),
    ];
    if at.z <= 0.0 { f64::NEG_INFINITY } else { sides.into_iter().fold(f64::INFINITY, f64::min) }
}
