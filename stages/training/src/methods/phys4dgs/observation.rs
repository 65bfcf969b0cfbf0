//! What images show of the motion of points, as constants: no gradient flows to what was seen.

use scene::VelocityMap;
use shaders::point_lookup::{PointsInImage, Sampled, Sampling, lookup, project_points, unproject};
use shaders::splat::{self, PinholeCamera, Rendered};
use shaders::tape::{Device, Real, Tape, Tensor};

use super::PhysicalGaussians;
use crate::method::{Moment, Step, TrainingView, too_large};
use crate::state::Variables;
use crate::supplements::FlowPrior;

/// A Gaussian farther than this share of the depth from the surface in its pixel is hidden by it, or not part of it.
const ON_SURFACE: f64 = 0.05;
/// Depth and flow are interpolated where neighbouring pixels differ by less than this share.
const SAMPLING: Sampling = Sampling::NearestAcrossEdges { relative: 0.1 };

/// M points as a view shows them.
pub struct Sight<T: Real> {
    /// [M, 2] px.
    pixels: Tensor<T>,
    /// [M]: z of the surface there, view space.
    surface_depths: Tensor<T>,
    /// [M]: the point lies on that surface.
    visible: Vec<bool>,
}

/// Displacements per frame that something else than the model tells.
pub struct Observed<T: Real> {
    /// [M, 3] world, scene units per frame; 0 where nothing is seen.
    pub displacements: Tensor<T>,
    /// [M]: 0 where nothing is seen.
    pub weights: Tensor<T>,
}

/// Expected depth Σwz / Σw [H, W] of a render with depth; NaN where it covers no more than `min_coverage`.
pub fn surface_depth<T: Real>(tape: &Tape<T>, rendered: &Rendered, min_coverage: f64) -> Tensor<T> {
    let (depth, alpha) = (tape.value(rendered.depth.expect("rendered with depth")), tape.value(rendered.alpha));
    let (unknown, min_coverage) = (T::from_f64(f64::NAN), T::from_f64(min_coverage));
    let expected = |(&depth, &alpha): (&T, &T)| if alpha > min_coverage { depth / alpha } else { unknown };
    let values = depth.as_slice().iter().zip(alpha.as_slice()).map(expected).collect();
    Tensor::from_vec(alpha.shape(), values)
}

impl<T: Real> Sight<T> {
    /// Points [M, 3] (world) in an image with these depths [H, W] of its surfaces.
    pub fn of(points: &Tensor<T>, camera: &PinholeCamera, near_view: f64, surface_depth: Tensor<T>) -> Self {
        let mut tape = Tape::new(Device::Cpu);
        let points = tape.constant(points.clone());
        let PointsInImage { pixels, depths } = project_points(&mut tape, points, camera, near_view);
        let surface = tape.constant(surface_depth);
        let Sampled { values, valid } = lookup(&mut tape, surface, pixels, SAMPLING);
        let (depths, surface_depths) = (tape.value(depths).as_slice(), tape.value(values).clone());
        let on_surface = |at: usize| {
            let surface = surface_depths.as_slice()[at];
            valid[at] && (depths[at] - surface).abs() < T::from_f64(ON_SURFACE) * surface
        };
        let visible = (0..depths.len()).map(on_surface).collect();
        Self { pixels: tape.value(pixels).clone(), surface_depths, visible }
    }
}

/// Exact displacements within one frame (eq 4): velocity times its duration.
pub fn true_displacements<T: Real>(sight: &Sight<T>, velocity: &VelocityMap, frame_secs: f64) -> Observed<T> {
    let mut tape = Tape::new(Device::Cpu);
    let per_frame = |value: &f32| T::from_f64(f64::from(*value) * frame_secs);
    let values = velocity.velocity_world.as_flattened().iter().map(per_frame).collect();
    let map = tape.constant(Tensor::from_vec([velocity.height as usize, velocity.width as usize, 3], values));
    let pixels = tape.constant(sight.pixels.clone());
    let Sampled { values, valid } = lookup(&mut tape, map, pixels, SAMPLING);
    Observed::where_all(tape.value(values), &[&sight.visible, &valid])
}

/// Displacements per frame that optical flow tells (eq 2): the points behind a pixel before and after, each in the
/// depth that is rendered there; `frames` lie between.
pub fn flow_displacements<T: Real>(
    sight: &Sight<T>,
    camera: &PinholeCamera,
    flow: &FlowPrior,
    surface_depth_to: &Tensor<T>,
    frames: f64,
) -> Observed<T> {
    let mut tape = Tape::new(Device::Cpu);
    let values = flow.map.flow_px.as_flattened().iter().map(|&value| T::from_f64(f64::from(value))).collect();
    let map = tape.constant(Tensor::from_vec([flow.map.height as usize, flow.map.width as usize, 2], values));
    let (pixels, depths) = (tape.constant(sight.pixels.clone()), tape.constant(sight.surface_depths.clone()));
    let shift = lookup(&mut tape, map, pixels, SAMPLING);
    let pixels_to = shaders::pointwise::add(&mut tape, pixels, shift.values);
    let surface_to = tape.constant(surface_depth_to.clone());
    let depths_to = lookup(&mut tape, surface_to, pixels_to, SAMPLING);
    let before = unproject(&mut tape, pixels, depths, camera);
    let after = unproject(&mut tape, pixels_to, depths_to.values, &PinholeCamera::from(&flow.camera_to));
    let displacement = shaders::pointwise::sub(&mut tape, after, before);
    let per_frame = shaders::pointwise::scale(&mut tape, displacement, 1.0 / frames);
    Observed::where_all(tape.value(per_frame), &[&sight.visible, &shift.valid, &depths_to.valid])
}

impl<T: Real> Observed<T> {
    /// Displacements with weight 1 where all conditions hold, zeros elsewhere.
    fn where_all(displacements: &Tensor<T>, conditions: &[&[bool]]) -> Self {
        let holds = |row: usize| conditions.iter().all(|condition| condition[row]);
        let rows = 0..displacements.rows();
        let row = |row: usize| if holds(row) { displacements.row(row).to_vec() } else { vec![T::ZERO; 3] };
        let weights = rows.clone().map(|row| if holds(row) { T::ONE } else { T::ZERO }).collect();
        Self {
            displacements: Tensor::from_vec(displacements.shape(), rows.clone().flat_map(row).collect()),
            weights: Tensor::from_vec([rows.len()], weights),
        }
    }

    /// The middle one of the displacements' lengths, scene units per frame; 0 where nothing is seen.
    pub fn median_length(&self) -> f64 {
        let is_seen = |row: &usize| self.weights.as_slice()[*row] > T::ZERO;
        let length = |row| self.displacements.row(row).iter().map(|value| value.to_f64().powi(2)).sum::<f64>().sqrt();
        let mut lengths: Vec<f64> = (0..self.displacements.rows()).filter(is_seen).map(length).collect();
        lengths.sort_unstable_by(f64::total_cmp);
        lengths.get(lengths.len() / 2).copied().unwrap_or(0.0)
    }

    /// Weighted so that the square pulls no harder than at a distance of `limit` from `estimate`: one step of
    /// iteratively reweighted least squares for the loss of Huber (1964).
    pub fn without_outliers(&self, estimate: &Tensor<T>, limit: f64) -> Self {
        let weight = |(row, &weight): (usize, &T)| {
            let squares = estimate.row(row).iter().zip(self.displacements.row(row)).map(|(&a, &b)| (a - b) * (a - b));
            let distance = squares.sum::<T>().sqrt();
            weight * (T::from_f64(limit) / distance.max(T::from_f64(limit)))
        };
        let weights = self.weights.as_slice().iter().enumerate().map(weight).collect();
        Self { displacements: self.displacements.clone(), weights: Tensor::from_vec(self.weights.shape(), weights) }
    }
}

impl PhysicalGaussians {
    /// Whether a view's step compares motion with anything that was seen; only then is depth rendered.
    pub(super) fn observes<T: Real>(&self, step: &Step<'_, T>, view: &TrainingView<T>) -> bool {
        self.velocity_of(step, view).is_some() || self.flow_of(step, view).is_some()
    }

    /// The exact velocities in a view, where they are known and wanted.
    pub(super) fn velocity_of<'a, T: Real>(
        &self,
        step: &Step<'a, T>,
        view: &TrainingView<T>,
    ) -> Option<&'a VelocityMap> {
        let wanted = self.parts.true_displacement && view.time < 1.0;
        step.supplements.view(view.index).filter(|_| wanted)?.velocity.as_ref()
    }

    /// The flow of a view, where it is given and wanted, leads on in time and anything moves.
    pub(super) fn flow_of<'a, T: Real>(&self, step: &Step<'a, T>, view: &TrainingView<T>) -> Option<&'a FlowPrior> {
        let flow = step.supplements.view(view.index).filter(|_| self.parts.flow)?.flow.as_ref()?;
        let leads_on = step.scene.time_map.normalized(flow.time_to_secs) > view.time;
        (leads_on && !stands_still(step, view)).then_some(flow)
    }

    /// The depths [H, W] of the surfaces where a flow arrives, rendered without gradients.
    pub(super) fn surface_at<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        time: f64,
        flow: &FlowPrior,
    ) -> anyhow::Result<Tensor<T>> {
        let mut tape = Tape::new(Device::Cpu);
        let constant = |(name, var): (&str, _)| (name.to_string(), tape.constant(step.tape.value(var).clone()));
        let model = Variables::new(step.model.iter().map(constant).collect());
        let camera = PinholeCamera::from(&flow.camera_to);
        let moment = Moment { scene: step.scene, phase: step.phase, time, camera: &camera, sh_degree: step.sh_degree };
        let splats = self.base.splats(&mut tape, &model, &moment);
        let rendered = splat::render(&mut tape, &splats, None, &camera, &step.raster).map_err(too_large)?;
        Ok(surface_depth(&tape, &rendered, self.settings.min_coverage))
    }
}

/// Whether a view is known to show nothing that moves.
fn stands_still<T: Real>(step: &Step<'_, T>, view: &TrainingView<T>) -> bool {
    step.supplements.moving(view.index).is_some_and(|moving| moving.labels.iter().all(|&label| label == 0))
}
