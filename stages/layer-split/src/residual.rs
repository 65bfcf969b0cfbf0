//! Motion segmentation by residual flow: optical flow that camera motion does not explain.

use depth_flow_import::FlowPrior;
use scene::{Camera, DepthMap, FlowMap, Mask, pixels};

use crate::Params;

/// The lower quartile of a Rayleigh distribution, in standard deviations of one coordinate. The noise is estimated from
/// the lower quartile of the residuals, so that up to three quarters of a view may move.
const RAYLEIGH_LOWER_QUARTILE: f64 = 0.7585;
/// Largest relative depth difference of neighbouring pixels on one surface.
const SAME_SURFACE: f32 = 0.05;

/// The moving pixels of a view: those whose flow differs by more than a threshold from the rigid flow of `camera` with
/// `depth`. A pixel without flow (occluded at the target time) takes the label of its nearest neighbours on the same
/// surface, and is treated as static if these are unknown, too.
pub(crate) fn moving(flow: &FlowPrior, depth: &DepthMap, camera: &Camera, params: &Params) -> Mask {
    let rigid = FlowMap::rigid(depth, camera, &flow.camera_to);
    let residual = |(flow, rigid): (&[f32; 2], &[f32; 2])| {
        let length = (flow[0] - rigid[0]).hypot(flow[1] - rigid[1]);
        length.is_finite().then_some(length)
    };
    let residuals_px: Vec<Option<f32>> = flow.map.flow_px.iter().zip(&rigid.flow_px).map(residual).collect();
    let threshold_px = threshold_px(&residuals_px, params) as f32;
    let known = residuals_px.iter().map(|residual| residual.map(|residual| residual > threshold_px)).collect();
    let inside = extended(known, depth).into_iter().map(|moves| moves == Some(true)).collect();
    let mask = Mask { width: depth.width, height: depth.height, inside };
    mask.closed(params.closing_px).without_specks(params.min_area_px)
}

/// `max(min_residual_px, noise_multiple · σ)`, where σ is the estimated noise of the flow in this view.
fn threshold_px(residuals_px: &[Option<f32>], params: &Params) -> f64 {
    let mut known: Vec<f32> = residuals_px.iter().copied().flatten().collect();
    if known.is_empty() {
        return params.min_residual_px;
    }
    let quarter = known.len() / 4;
    let lower_quartile_px = *known.select_nth_unstable_by(quarter, f32::total_cmp).1;
    let noise_px = f64::from(lower_quartile_px) / RAYLEIGH_LOWER_QUARTILE;
    params.min_residual_px.max(params.noise_multiple * noise_px)
}

/// Labels unknown pixels, ring by ring, like the neighbour with the most similar depth on the same surface.
fn extended(mut known: Vec<Option<bool>>, depth: &DepthMap) -> Vec<Option<bool>> {
    let difference = |a: usize, b: usize| (depth.depth_view[a] / depth.depth_view[b]).ln().abs();
    let has_depth = |at: &usize| depth.depth_view[*at] > 0.0;
    let mut unknown: Vec<usize> = (0..known.len()).filter(|at| known[*at].is_none()).filter(has_depth).collect();
    loop {
        let best = |at: &usize| {
            let labelled = pixels::neighbors(*at, depth.width, depth.height)
                .filter(|other| known[*other].is_some() && has_depth(other));
            let like = labelled.map(|other| (difference(*at, other), other)).filter(|like| like.0 <= SAME_SURFACE);
            let (_, from) = like.min_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((*at, known[from]))
        };
        let learnt: Vec<_> = unknown.iter().filter_map(best).collect();
        if learnt.is_empty() {
            return known;
        }
        learnt.into_iter().for_each(|(at, moves)| known[at] = moves);
        unknown.retain(|at| known[*at].is_none());
    }
}

/// Forward-warps the mask of a view along its flow, into the view that the flow leads to.
pub(crate) fn carried(moving: &Mask, flow: &FlowPrior) -> Mask {
    let (width, height) = (moving.width, moving.height);
    let mut arrived = Mask::empty(width, height);
    let places = (0..moving.inside.len()).filter(|at| moving.inside[*at]);
    for at in places {
        let [right, down] = flow.map.flow_px[at];
        let (x, y) = ((at as u32 % width) as f32 + 0.5 + right, (at as u32 / width) as f32 + 0.5 + down);
        if x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 {
            arrived.inside[y as usize * width as usize + x as usize] = true;
        }
    }
    // Diverging neighbours leave gaps of one pixel.
    arrived.closed(1)
}
