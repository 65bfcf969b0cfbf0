//! The momentum field: confidence times the optical flow that camera motion does not explain (KineticGS, equation 3).
//!
//! For the pixel u of camera t with depth d and flow f to camera t + s,
//! `f_geom(u) = π_{t+s}(π_t⁻¹(u, d)) - u` and `p(u) = m(u) (f(u) - f_geom(u)) / s`, in pixels per frame.

use depth_flow_import::FlowPrior;
use glam::{DVec2, DVec3};
use scene::statistics::median;
use scene::{Camera, pixels};

use crate::Params;
use crate::maps::MotionView;

/// The momentum of one view relative to later instants.
pub(crate) struct Momentum {
    /// [H, W] squared norms, summed over the strides, in (pixels per frame)²; `None` where the pixel has no depth and
    /// cannot become a particle.
    pub(crate) squared_norm: Vec<Option<f64>>,
    /// The strides for which any pixel has flow.
    pub(crate) strides: Vec<usize>,
}

/// Computes the momentum of the view `start` over all strides; `load` loads the views that the flow passes through.
pub(crate) fn momentum(
    start: &MotionView,
    params: &Params,
    load: &dyn Fn(usize) -> anyhow::Result<MotionView>,
) -> anyhow::Result<Momentum> {
    let mut squared_norm: Vec<Option<f64>> =
        (0..start.depth.depth_view.len()).map(|pixel| start.depth.known(pixel).map(|_| 0.0)).collect();
    let slopes = slope_confidence(start, params.depth_slope);
    let mut strides = Vec::new();
    let mut tracks = Tracks::start(start);
    // Flow is chained from view to view; every pixel of the start view carries its current position.
    let mut current: Option<MotionView> = None;
    for stride in 1..=params.strides.last().copied().unwrap_or(0) {
        let Some(flow) = current.as_ref().unwrap_or(start).flow.as_ref() else { break };
        tracks.follow(flow);
        let (camera_to, view_to) = (flow.camera_to, flow.view_to);
        let next = view_to.map(load).transpose()?;
        if params.strides.contains(&stride) && tracks.positions.iter().any(Option::is_some) {
            strides.push(stride);
            let arrivals: Vec<Option<Arrival>> = (0..squared_norm.len())
                .map(|pixel| arrival(start, pixel, tracks.positions[pixel]?, &camera_to, next.as_ref()))
                .collect();
            let deviations = deviations(&arrivals, tracks.size);
            for (pixel, sum) in squared_norm.iter_mut().enumerate() {
                let (Some(sum), Some(arrival)) = (sum, &arrivals[pixel]) else { continue };
                let confidence = slopes[pixel] * (-deviations[pixel] / params.depth_error).exp();
                *sum += (confidence * arrival.momentum_px / stride as f64).length_squared();
            }
        }
        let Some(next) = next else { break };
        current = Some(next);
    }
    Ok(Momentum { squared_norm, strides })
}

/// Positions of the pixels of the first view, advected along the flow.
struct Tracks {
    /// Current position of every pixel; `None` once its flow is unknown.
    positions: Vec<Option<DVec2>>,
    /// Width and height.
    size: (u32, u32),
}

impl Tracks {
    /// Starts every pixel at its centre.
    fn start(view: &MotionView) -> Self {
        let size = (view.depth.width, view.depth.height);
        let positions = (0..view.depth.depth_view.len()).map(|pixel| Some(pixels::center(pixel, size.0))).collect();
        Self { positions, size }
    }

    /// Advances one step along `flow`, which is read at the nearest pixel: interpolation would mix moving and static
    /// pixels along every outline.
    fn follow(&mut self, flow: &FlowPrior) {
        let (width, height) = self.size;
        for position in &mut self.positions {
            *position = position.and_then(|from| {
                let [right, down] = flow.map.flow_px[pixels::index_at(from, width, height)?];
                let moved = from + DVec2::new(f64::from(right), f64::from(down));
                moved.is_finite().then_some(moved)
            });
        }
    }
}

/// The motion of a pixel's surface point according to the flow, relative to a static point.
#[derive(Clone, Copy)]
struct Arrival {
    /// Flow that camera motion does not explain, px.
    momentum_px: DVec2,
    /// Change of the depth at the end of the flow, relative to that of the static point; unknown without depth there.
    depth_change: Option<f64>,
}

/// Compares the end of a pixel's flow, `moved`, with the projection of the static point into the camera there.
fn arrival(
    start: &MotionView,
    pixel: usize,
    moved: DVec2,
    camera_to: &Camera,
    next: Option<&MotionView>,
) -> Option<Arrival> {
    let (position, depth_view) = camera_to.project(surface_point(start, pixel)?)?;
    let depth = next.and_then(|next| next.depth.known(pixels::index_at(moved, next.depth.width, next.depth.height)?));
    let depth_change = depth.map(|depth| (depth - depth_view) / depth_view);
    Some(Arrival { momentum_px: moved - position, depth_change })
}

/// The world position of the surface point at the centre of a pixel (equation 5); `None` without depth.
pub(crate) fn surface_point(view: &MotionView, pixel: usize) -> Option<DVec3> {
    let depth_view = view.depth.known(pixel)?;
    Some(view.camera.unproject(pixels::center(pixel, view.depth.width), depth_view))
}

/// Confidence `exp(-‖∇d‖₁ / (slope · d))` per pixel: low where depth is steep and thus unreliable, 0 next to pixels
/// without depth.
fn slope_confidence(view: &MotionView, slope: f64) -> Vec<f64> {
    let (width, height) = (view.depth.width as usize, view.depth.height as usize);
    let confidence = |pixel: usize| {
        let (column, row) = (pixel % width, pixel / width);
        let right = if column + 1 < width { pixel + 1 } else { pixel };
        let below = if row + 1 < height { pixel + width } else { pixel };
        let [Some(centre), Some(right), Some(below)] = [pixel, right, below].map(|at| view.depth.known(at)) else {
            return 0.0;
        };
        let gradient = (right - centre).abs() + (below - centre).abs();
        (-gradient / (slope * centre)).exp()
    };
    (0..width * height).map(confidence).collect()
}

/// The deviation of the change of depth at each pixel from the median around it (3 × 3 pixels); 0 where it is unknown.
/// A surface that approaches the camera changes evenly; a flow that ends on another surface does not.
fn deviations(arrivals: &[Option<Arrival>], (width, height): (u32, u32)) -> Vec<f64> {
    let change = |pixel: usize| arrivals[pixel]?.depth_change;
    let deviation = |pixel: usize| {
        let around = pixels::neighbors(pixel, width, height).chain([pixel]).filter_map(change);
        Some((change(pixel)? - median(around)?).abs())
    };
    (0..arrivals.len()).map(|pixel| deviation(pixel).unwrap_or(0.0)).collect()
}
