//! What momentum is computed from, view by view.

use glam::DVec2;
use scene::{Camera, DepthMap, FlowMap};

/// Geometry and motion of one view.
pub struct MotionView {
    /// Pinhole and pose.
    pub camera: Camera,
    /// View-space z; 0 where there is none.
    pub depth: DepthMap,
    /// To the next instant, where it is known.
    pub flow: Option<MotionFlow>,
}

/// Optical flow and where it leads.
pub struct MotionFlow {
    /// Displacement in pixels; NaN where there is none.
    pub map: FlowMap,
    /// The camera that sees the pixels where they arrive.
    pub camera_to: Camera,
    /// The view that shows them there, if any does.
    pub view_to: Option<usize>,
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
