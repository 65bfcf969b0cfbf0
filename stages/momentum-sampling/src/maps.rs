//! The geometry and motion of one view, from which momentum is computed.

use depth_flow_import::{FlowPrior, Priors};
use scene::{Camera, DepthMap};

/// Geometry and motion of one view.
pub(crate) struct MotionView {
    /// Intrinsics and pose.
    pub(crate) camera: Camera,
    /// View-space z; 0 where unknown.
    pub(crate) depth: DepthMap,
    /// Flow to the next instant, if known.
    pub(crate) flow: Option<FlowPrior>,
}

impl MotionView {
    /// Loads the view at `index` within the views of the capture. A view without a depth map has depth 0 everywhere.
    pub(crate) fn load(priors: &Priors, index: usize) -> scene::Result<Self> {
        let camera = priors.views[index].camera;
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let unknown = || DepthMap { width, height, depth_view: vec![0.0; width as usize * height as usize] };
        let depth = priors.load_depth(index)?.unwrap_or_else(unknown);
        Ok(Self { camera, depth, flow: priors.load_flow(index)? })
    }
}
