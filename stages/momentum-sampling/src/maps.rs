//! What momentum is computed from, view by view.

use depth_flow_import::{FlowPrior, Priors};
use glam::DVec2;
use scene::{Camera, DepthMap};

/// Geometry and motion of one view.
pub struct MotionView {
    /// Pinhole and pose.
    pub camera: Camera,
    /// View-space z; 0 where there is none.
    pub depth: DepthMap,
    /// To the next instant, where it is known.
    pub flow: Option<FlowPrior>,
}

impl MotionView {
    /// The view at `index` within the capture's views; depth that is not known is 0 everywhere.
    pub fn load(priors: &Priors, index: usize) -> scene::Result<Self> {
        let camera = priors.views[index].camera;
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let unknown = || DepthMap { width, height, depth_view: vec![0.0; width as usize * height as usize] };
        let depth = priors.load_depth(index)?.unwrap_or_else(unknown);
        Ok(Self { camera, depth, flow: priors.load_flow(index)? })
    }
}

/// The index of the pixel that holds a position; `None` outside of the image and for NaN.
pub fn pixel_at(position: DVec2, width: u32, height: u32) -> Option<usize> {
    let inside = position.cmpge(DVec2::ZERO).all() && position.x < f64::from(width) && position.y < f64::from(height);
    inside.then(|| position.y as usize * width as usize + position.x as usize)
}

/// The centre of a pixel.
pub fn pixel_centre(pixel: usize, width: u32) -> DVec2 {
    let width = width as usize;
    DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5)
}
