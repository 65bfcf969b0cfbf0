//! Optical flow that camera motion alone explains.

use glam::DVec2;

use super::{DepthMap, FlowMap};
use crate::{Camera, pixels};

impl FlowMap {
    /// The optical flow of a static scene: every pixel of camera `from` is unprojected with its depth and projected
    /// into camera `to`. NaN where the depth is unknown or the point lies behind `to`.
    pub fn rigid(depth: &DepthMap, from: &Camera, to: &Camera) -> Self {
        let world_from_camera = from.camera_from_world.inverse();
        let flow = |(center, depth_view): (DVec2, &f32)| {
            let point_world = world_from_camera.apply(from.ray_view(center) * f64::from(*depth_view));
            let arrival = if *depth_view > 0.0 { to.project(point_world) } else { None };
            arrival.map_or([f32::NAN; 2], |(pixel, _)| (pixel - center).as_vec2().to_array())
        };
        let flow_px = pixels::centers(depth.width, depth.height).zip(&depth.depth_view).map(flow).collect();
        Self { width: depth.width, height: depth.height, flow_px }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::{Intrinsics, RigidTransform};

    #[test]
    fn a_sideways_camera_shifts_points_by_their_disparity() {
        let intrinsics = Intrinsics { width: 2, height: 1, focal_x: 8.0, focal_y: 8.0, center_x: 1.0, center_y: 0.5 };
        let camera = |x: f64| {
            let translation = DVec3::new(-x, 0.0, 0.0);
            Camera { intrinsics, camera_from_world: RigidTransform { translation, ..RigidTransform::IDENTITY } }
        };
        let depth = DepthMap { width: 2, height: 1, depth_view: vec![4.0, 0.0] };
        let flow = FlowMap::rigid(&depth, &camera(0.0), &camera(0.25)).flow_px;
        // focal · baseline / depth
        assert_eq!(flow[0], [-0.5, 0.0]);
        assert!(flow[1][0].is_nan(), "a pixel without depth has no flow");
    }
}
