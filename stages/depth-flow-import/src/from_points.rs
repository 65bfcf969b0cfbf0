//! Depth without an estimator: the points of the capture, interpolated over each image.
//!
//! Structure from motion triangulates static points only, so this is the depth of the static scene. A moving object
//! gets the depth of its surroundings.

use engine::{Failure, FailureKind};
use glam::{DVec2, DVec3};
use scene::point_tree::PointTree;
use scene::{Camera, Capture, DepthMap, PointCloud, pixels};

/// Number of points that a pixel is interpolated from: enough to average out noise, few enough to stay local.
const NEIGHBORS: usize = 8;
/// Minimum number of points in an image.
const MIN_POINTS: usize = 16;
/// Added to every squared distance, so that a point at a pixel centre does not outweigh all others.
const SOFTENING_PX2: f64 = 1.0;

/// The points of a capture; a failure if it has none.
pub(crate) fn points(capture: &Capture) -> anyhow::Result<PointCloud> {
    let hint = "import a capture with structure from motion, or set source = \"files\" to import an estimator's maps";
    let message = "the capture has no points to interpolate depth from";
    let missing = || Failure::new(FailureKind::BadInput, message).hint(hint).at(&capture.dir);
    Ok(capture.load_points()?.ok_or_else(missing)?)
}

/// View-space z of every pixel: the mean of the inverse depths of the nearest points in the image, weighted by the
/// inverse squared distance in pixels (Shepard 1968). Inverse depth is interpolated because it is linear in the image
/// of a plane.
/// `None` if the camera sees too few points.
pub(crate) fn depth_view(points: &PointCloud, camera: &Camera) -> Option<DepthMap> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let size = DVec2::new(f64::from(width), f64::from(height));
    let project = |point: &[f32; 3]| camera.project(DVec3::from(point.map(f64::from)));
    let inside = |(pixel, _): &(DVec2, f64)| pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
    let seen: Vec<(DVec2, f64)> = points.positions.iter().filter_map(project).filter(inside).collect();
    if seen.len() < MIN_POINTS {
        return None;
    }
    let pixels: Vec<[f64; 2]> = seen.iter().map(|(pixel, _)| pixel.to_array()).collect();
    let tree = PointTree::new(&pixels);
    let depth = |center: DVec2| {
        let (mut weighted, mut weights) = (0.0, 0.0);
        for neighbor in tree.nearests(&center.to_array(), NEIGHBORS) {
            let weight = 1.0 / (neighbor.squared_distance + SOFTENING_PX2);
            weighted += weight / seen[neighbor.index].1;
            weights += weight;
        }
        (weights / weighted) as f32
    };
    Some(DepthMap { width, height, depth_view: pixels::centers(width, height).map(depth).collect() })
}

#[cfg(test)]
mod tests {
    use scene::Intrinsics;

    use super::*;

    fn camera() -> Camera {
        let intrinsics =
            Intrinsics { width: 40, height: 30, focal_x: 50.0, focal_y: 50.0, center_x: 20.0, center_y: 15.0 };
        Camera::look_at(intrinsics, DVec3::new(0.0, -4.0, 1.0), DVec3::ZERO, DVec3::Z)
    }

    /// `count` points on the floor z = 0, and as many behind the camera.
    fn floor(count: usize) -> PointCloud {
        let mut cloud = PointCloud::random_in([[-2.0, -2.0, 0.0], [2.0, 3.0, 0.0]], count, 1);
        cloud.positions.extend((0..count).map(|at| [at as f32, -9.0, 0.0]));
        cloud.colors.resize(2 * count, [0; 3]);
        cloud
    }

    #[test]
    fn a_plane_is_recovered_from_points_on_it() {
        let camera = camera();
        let map = depth_view(&floor(3000), &camera).unwrap();
        let world_from_camera = camera.camera_from_world.inverse();
        let mut compared = 0;
        for (center, depth) in pixels::centers(40, 30).zip(&map.depth_view) {
            let ray = world_from_camera.rotation * camera.ray_view(center);
            let expected = -world_from_camera.translation.z / ray.z;
            let point = world_from_camera.translation + expected * ray;
            // The depth is unknown beyond the border of the floor.
            if expected > 0.0 && point.x.abs() < 1.7 && point.y.abs() < 1.7 {
                let error = (f64::from(*depth) / expected - 1.0).abs();
                assert!(error <= 0.05, "{center}: {depth} instead of {expected}");
                compared += 1;
            }
        }
        assert!(compared >= 400, "only {compared} pixels see the floor");
    }

    #[test]
    fn too_few_points_give_no_depth() {
        assert!(depth_view(&floor(3), &camera()).is_none());
        assert!(depth_view(&PointCloud::default(), &camera()).is_none());
    }
}
