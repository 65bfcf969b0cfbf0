//! The energy-flow loss (KineticGS equations 2 and 6): flow and depth at the pixel of a visible particle give its
//! position at the next time.
//!
//! A particle is visible where its depth agrees with the view's. Its target is the back-projection of the pixel at the
//! end of the flow, at that view's depth. If no view has depth there, only the ray is known, and the particle is
//! constrained to the ray. Targets are observations: no gradient flows through them.

use glam::DVec2;
use scene::{Camera, DepthMap, pixels};
use shaders::arrays::rows::{gather, norm, row_dot, scale_rows};
use shaders::arrays::totals::{total, weighted_mean};
use shaders::geometry::point_lookup::{FlowMaps, PinholeCamera, flow_targets};
use shaders::pointwise::sub;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::particles::{Moved, ParticleMotion, Particles};
use crate::data::{Dataset, FlowPrior, Supplements, ViewConstants, ViewPriors};
use crate::model::Variables;

/// Pixels with flow that differs by more than this from that of a static scene are moving; px.
const RESIDUAL_FLOW_PX: f64 = 1.0;

/// Depth and flow of one view, and the depth at the end of the flow if known.
pub(crate) struct FlowView<'a> {
    view: usize,
    camera: Camera,
    depth: &'a DepthMap,
    flow: &'a FlowPrior,
    /// Depth at the end of the flow, with the index of its view.
    depth_to: Option<(usize, &'a DepthMap)>,
}

/// Error of the particles against the flow of a view.
pub(crate) struct Followed {
    /// Mean distance of the visible particles to their targets, [1], scene units; 0 if none is visible.
    pub distance: Var,
    /// Number of visible particles, [1].
    pub count: Var,
}

impl<'a> FlowView<'a> {
    /// The view's priors; `None` where depth or flow are missing.
    pub(crate) fn of(dataset: &Dataset, supplements: &'a Supplements, view: usize) -> Option<Self> {
        let ViewPriors { depth, flow, .. } = supplements.view(view)?;
        let (depth, flow) = (depth.as_ref()?, flow.as_ref()?);
        let depth_of = |to: usize| Some((to, supplements.view(to)?.depth.as_ref()?));
        let depth_to = flow.view_to.and_then(depth_of);
        Some(Self { view, camera: dataset.capture.views[view].camera, depth, flow, depth_to })
    }

    /// The time at which the flow ends, in seconds.
    pub(crate) fn time_to_secs(&self) -> f64 {
        self.flow.time_to_secs
    }

    /// The maps on a device, cached in `constants`.
    pub(crate) fn maps<T: Real>(&self, device: Device, constants: &ViewConstants<T>) -> FlowMaps<T> {
        let depth = |(view, map): (usize, &DepthMap)| {
            constants.get(device, "depth", view, || tensor(map.height, map.width, &[], &map.depth_view))
        };
        let FlowPrior { map, camera_to, .. } = self.flow;
        let flow = || tensor(map.height, map.width, &[2], map.flow_px.as_flattened());
        FlowMaps {
            camera: PinholeCamera::from(&self.camera),
            depth: depth((self.view, self.depth)),
            flow: constants.get(device, "flow", self.view, flow),
            camera_to: PinholeCamera::from(camera_to),
            depth_to: self.depth_to.map(depth),
        }
    }

    /// [H, W, 3]: 0 for pixels that move relative to the static scene; 1 for static pixels and for those with unknown
    /// motion.
    pub(crate) fn static_pixels<T: Real>(&self) -> Tensor<T> {
        let DepthMap { width, height, ref depth_view } = *self.depth;
        let mask = (0..depth_view.len()).flat_map(|index| [if self.moves(index) { T::ZERO } else { T::ONE }; 3]);
        Tensor::from_vec([height as usize, width as usize, 3], mask.collect())
    }

    /// Whether a pixel moves relative to the static scene; false if unknown.
    fn moves(&self, index: usize) -> bool {
        let pixel = pixels::center(index, self.depth.width);
        let residual = || {
            let (depth, flow) = (self.depth.known(index)?, self.flow_at(pixel)?);
            let (static_arrival, _) = self.flow.camera_to.project(self.camera.unproject(pixel, depth))?;
            Some((pixel + flow).distance(static_arrival))
        };
        residual().is_some_and(|residual| residual > RESIDUAL_FLOW_PX)
    }

    fn flow_at(&self, pixel: DVec2) -> Option<DVec2> {
        let map = &self.flow.map;
        let [x, y] = map.flow_px[pixels::index_at(pixel, map.width, map.height)?];
        (x.is_finite() && y.is_finite()).then_some(DVec2::new(x.into(), y.into()))
    }
}

/// The energy-flow error at `time_to`, the end of the flow, of all particles that the view sees, active or not: a
/// closed window learns to open when the flow moves its particle. `None` without particles.
pub(crate) fn energy_flow<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    motion: &ParticleMotion,
    particles: &Particles<'_, T>,
    moved: &Moved,
    maps: &FlowMaps<T>,
    time_to: f64,
) -> Option<Followed> {
    let rows = &particles.population.rows;
    if rows.is_empty() {
        return None;
    }
    let positions = gather(tape, moved.anchors.positions, rows);
    let positions = tape.detach(positions);
    let targets = flow_targets(tape, positions, maps);
    let found = motion.positions_at(tape, model, particles, time_to);
    let missed = sub(tape, found, targets.positions);
    let along = row_dot(tape, missed, targets.free);
    let along = scale_rows(tape, targets.free, along);
    let across = sub(tape, missed, along);
    let distances = norm(tape, across);
    Some(Followed { distance: weighted_mean(tape, distances, targets.seen), count: total(tape, targets.seen) })
}

/// A map as a tensor [H, W, …].
fn tensor<T: Real>(height: u32, width: u32, pixel: &[usize], values: &[f32]) -> Tensor<T> {
    let shape = [&[height as usize, width as usize], pixel].concat();
    Tensor::from_vec(shape, values.iter().map(|&value| T::from_f64(value.into())).collect())
}
