//! The momentum field: confidence times the optical flow that camera motion does not explain (KineticGS, equation 3).
//!
//! For the pixel u of camera t with depth d and flow f to camera t + s,
//! `f_geom(u) = π_{t+s}(π_t⁻¹(u, d)) - u` and `p(u) = m(u) (f(u) - f_geom(u)) / s`, in pixels per frame.

use depth_flow_import::FlowPrior;
use glam::{DVec2, DVec3};
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
        start.depth.depth_view.iter().map(|depth| has_depth(*depth).then_some(0.0)).collect();
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
            for (pixel, sum) in squared_norm.iter_mut().enumerate() {
                let (Some(sum), Some(moved)) = (sum, tracks.positions[pixel]) else { continue };
                let Some(expected) = static_point(start, pixel, &camera_to) else { continue };
                let confidence = slopes[pixel] * arrival_confidence(moved, expected, next.as_ref(), params.depth_error);
                *sum += (confidence * (moved - expected.position) / stride as f64).length_squared();
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

/// Where a camera would see the surface point of a pixel if the point were static.
#[derive(Clone, Copy)]
struct StaticPoint {
    position: DVec2,
    depth_view: f64,
}

/// Projects the surface point of a pixel into another camera.
fn static_point(start: &MotionView, pixel: usize, camera_to: &Camera) -> Option<StaticPoint> {
    let (position, depth_view) = camera_to.project(surface_point(start, pixel)?)?;
    Some(StaticPoint { position, depth_view })
}

/// The world position of the surface point at the centre of a pixel (equation 5); `None` without depth.
pub(crate) fn surface_point(view: &MotionView, pixel: usize) -> Option<DVec3> {
    let depth = view.depth.depth_view[pixel];
    let ray = view.camera.ray_view(pixels::center(pixel, view.depth.width));
    has_depth(depth).then(|| view.camera.camera_from_world.inverse().apply(f64::from(depth) * ray))
}

/// Whether a depth is known.
fn has_depth(depth: f32) -> bool {
    depth > 0.0 && depth.is_finite()
}

/// Confidence `exp(-‖∇d‖₁ / (slope · d))` per pixel: low where depth is steep and thus unreliable, 0 next to pixels
/// without depth.
fn slope_confidence(view: &MotionView, slope: f64) -> Vec<f64> {
    let (width, height) = (view.depth.width as usize, view.depth.height as usize);
    let depth = |pixel: usize| view.depth.depth_view[pixel];
    let confidence = |pixel: usize| {
        let (column, row) = (pixel % width, pixel / width);
        let right = if column + 1 < width { pixel + 1 } else { pixel };
        let below = if row + 1 < height { pixel + width } else { pixel };
        if ![pixel, right, below].iter().all(|at| has_depth(depth(*at))) {
            return 0.0;
        }
        let centre = f64::from(depth(pixel));
        let gradient = (f64::from(depth(right)) - centre).abs() + (f64::from(depth(below)) - centre).abs();
        (-gradient / (slope * centre)).exp()
    };
    (0..width * height).map(confidence).collect()
}

/// Confidence `exp(-r / error)`, where r is the difference between the depth of the next view at the target of the flow
/// and the depth of the static point, relative to the latter; 1 if the depth of the next view is unknown.
fn arrival_confidence(moved: DVec2, expected: StaticPoint, next: Option<&MotionView>, error: f64) -> f64 {
    let arrived = next.and_then(|next| {
        let depth = next.depth.depth_view[pixels::index_at(moved, next.depth.width, next.depth.height)?];
        has_depth(depth).then_some(f64::from(depth))
    });
    arrived.map_or(1.0, |depth| (-(depth - expected.depth_view).abs() / expected.depth_view / error).exp())
}
