//! Particles follow the optical flow (KineticGS equations 2 and 6): where a particle is seen at one time, flow and depth
//! say where it is at the next.
//!
//! A particle counts as seen where the view's depth agrees with its own. The target is the back-projection of the pixel
//! where the flow leads, at the depth that the next view has there. Where no view shows the arrival, only the ray is known
//! and the particle is held to it. Targets are observations: no gradient flows through them.

use glam::{DVec2, DVec3};
use scene::{Camera, DepthMap};
use shaders::losses::mean;
use shaders::pointwise::sub;
use shaders::rows::{norm, row_dot, scale_rows};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::particles::{Moved, ParticleMotion, Particles};
use crate::dataset::Dataset;
use crate::state::Variables;
use crate::supplements::{FlowPrior, Supplements, ViewPriors};

/// A particle is seen where its depth differs from the view's by less than this share.
const DEPTH_TOLERANCE: f64 = 0.05;
/// Pixels whose flow differs by more from that of a static scene move; px.
const RESIDUAL_FLOW_PX: f64 = 1.0;

/// One view's depth and flow, and what is known of where the flow leads.
pub struct FlowView<'a> {
    camera: Camera,
    depth: &'a DepthMap,
    flow: &'a FlowPrior,
    depth_to: Option<&'a DepthMap>,
}

/// Where a particle should be at the next time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// World; a point of the ray where only the ray is known.
    pub position: DVec3,
    /// The direction along which nothing is known: a unit vector, or zero.
    pub free: DVec3,
}

impl<'a> FlowView<'a> {
    /// The view's priors; `None` where depth or flow are missing.
    pub fn of(dataset: &Dataset, supplements: &'a Supplements, view: usize) -> Option<Self> {
        let ViewPriors { depth, flow, .. } = supplements.view(view)?;
        let (depth, flow) = (depth.as_ref()?, flow.as_ref()?);
        let depth_to = flow.view_to.and_then(|to| supplements.view(to)).and_then(|priors| priors.depth.as_ref());
        Some(Self { camera: dataset.capture.views[view].camera, depth, flow, depth_to })
    }

    /// When the flow arrives, in seconds.
    pub fn time_to_secs(&self) -> f64 {
        self.flow.time_to_secs
    }

    /// Where what this view sees at `position` goes; `None` where the view does not see it, or does not know.
    pub fn target(&self, position: DVec3) -> Option<Target> {
        let (pixel, depth_view) = self.camera.project(position)?;
        let seen = depth_at(self.depth, pixel)?;
        let flow = self.flow_at(pixel)?;
        if !((depth_view - seen).abs() <= DEPTH_TOLERANCE * seen) {
            return None;
        }
        let arrival = pixel + flow;
        let camera_to = &self.flow.camera_to;
        Some(match self.depth_to.and_then(|depth| depth_at(depth, arrival)) {
            Some(depth) => Target { position: unproject(camera_to, arrival, depth), free: DVec3::ZERO },
            None => {
                let position = unproject(camera_to, arrival, seen);
                Target { position, free: (position - camera_to.position_world()).normalize_or_zero() }
            }
        })
    }

    /// [H·W] whether a pixel moves otherwise than the camera alone would move it; false where that is not known.
    pub fn moving_pixels(&self) -> Vec<bool> {
        let width = self.depth.width as usize;
        let moves = |index: usize| {
            let pixel = DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
            let (depth, flow) = (depth_at(self.depth, pixel)?, self.flow_at(pixel)?);
            let (static_arrival, _) = self.flow.camera_to.project(unproject(&self.camera, pixel, depth))?;
            Some((pixel + flow).distance(static_arrival) > RESIDUAL_FLOW_PX)
        };
        (0..self.depth.depth_view.len()).map(|index| moves(index).unwrap_or(false)).collect()
    }

    fn flow_at(&self, pixel: DVec2) -> Option<DVec2> {
        let map = &self.flow.map;
        let [x, y] = map.flow_px[index_of(pixel, map.width, map.height)?].map(f64::from);
        (x.is_finite() && y.is_finite()).then_some(DVec2::new(x, y))
    }
}

/// The mean distance of the particles that a view sees to where its flow leads them, scene units, and how many there are;
/// `None` where it sees none.
pub fn energy_flow<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    motion: &ParticleMotion,
    particles: &Particles,
    moved: &Moved,
    view: &FlowView<'_>,
    time_to: f64,
) -> Option<(Var, usize)> {
    let positions = tape.value(moved.anchors.positions);
    let place = |&particle: &u32| {
        let row = positions.row(particles.rows.row_of_item()[particle as usize] as usize);
        DVec3::from_array([0, 1, 2].map(|axis| row[axis].to_f64()))
    };
    let targets: Vec<Option<Target>> = moved.active.iter().map(|particle| view.target(place(particle))).collect();
    let seen = moved.active.iter().zip(&targets).filter_map(|(&particle, target)| Some((particle, (*target)?)));
    let seen: std::collections::BTreeMap<u32, Target> = seen.collect();
    let mut chosen: Vec<u32> = seen.keys().copied().collect();
    let found = motion.positions_at(tape, model, particles, &mut chosen, time_to)?;
    let observed = |part: fn(&Target) -> DVec3| {
        let rows = chosen.iter().flat_map(|particle| part(&seen[particle]).to_array()).map(T::from_f64).collect();
        Tensor::from_vec([chosen.len(), 3], rows)
    };
    let targets = tape.detach_value(observed(|target| target.position));
    let free = tape.detach_value(observed(|target| target.free));
    let missed = sub(tape, found, targets);
    let along = row_dot(tape, missed, free);
    let along = scale_rows(tape, free, along);
    let across = sub(tape, missed, along);
    let distances = norm(tape, across);
    Some((mean(tape, distances), chosen.len()))
}

/// [H, W, 3]: 1 where pixels stand still, 0 where they move.
pub fn static_mask<T: Real>(moving: &[bool], height: usize, width: usize) -> Tensor<T> {
    let stands = moving.iter().flat_map(|&moves| [if moves { T::ZERO } else { T::ONE }; 3]).collect();
    Tensor::from_vec([height, width, 3], stands)
}

/// The world point at a pixel position and view depth.
fn unproject(camera: &Camera, pixel: DVec2, depth_view: f64) -> DVec3 {
    camera.camera_from_world.inverse().apply(camera.ray_view(pixel) * depth_view)
}

/// The depth of the pixel that holds a position; `None` outside the image and where there is none.
fn depth_at(map: &DepthMap, pixel: DVec2) -> Option<f64> {
    let depth = f64::from(map.depth_view[index_of(pixel, map.width, map.height)?]);
    (depth > 0.0 && depth.is_finite()).then_some(depth)
}

fn index_of(pixel: DVec2, width: u32, height: u32) -> Option<usize> {
    let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(width) && pixel.y < f64::from(height);
    inside.then(|| pixel.y as usize * width as usize + pixel.x as usize)
}
