//! Maps that are part of the capture itself.

use scene::{Capture, View};

use crate::params::MapKind;
use crate::{FlowPrior, Params, ViewMaps};

/// Largest time difference, as a share of a frame, between the target of a flow and the view that shows it.
const SAME_INSTANT: f64 = 1e-3;

/// The maps of a view. The flow of a capture leads to what the same camera pose sees one frame later.
pub(crate) fn maps(capture: &Capture, view: &View, params: &Params) -> anyhow::Result<ViewMaps> {
    let frame_secs = capture.time_map.frame_secs;
    let time_to_secs = view.time_secs + frame_secs;
    let arrives = |other: &View| {
        let same_instant = (other.time_secs - time_to_secs).abs() <= SAME_INSTANT * frame_secs;
        other.split == view.split && other.camera == view.camera && same_instant
    };
    let flow = |map| {
        let view_to = capture.views.iter().position(arrives);
        FlowPrior { map, camera_to: view.camera, time_to_secs, view_to }
    };
    let wanted = |kind, has: bool| params.wants(kind) && has;
    Ok(ViewMaps {
        depth: if wanted(MapKind::Depth, view.depth.is_some()) { capture.load_depth(view)? } else { None },
        flow: if wanted(MapKind::Flow, view.flow.is_some()) { capture.load_flow(view)?.map(flow) } else { None },
        normals: None,
        velocity: if wanted(MapKind::Velocity, view.velocity.is_some()) { capture.load_velocity(view)? } else { None },
    })
}
