//! Motion of points as observed in images. Observations are constants: no gradient flows through them.

use scene::{FlowMap, VelocityMap};
use shaders::arrays::rows::{divide_rows, keep_rows, median_where, norm, repeat_row, reshape};
use shaders::geometry::camera::PinholeCamera;
use shaders::geometry::point_lookup::{PointsInImage, Sampled, Sampling, lookup, project_points, unproject};
use shaders::pointwise;
use shaders::pointwise::{add, mul, scale, sub};
use shaders::rasteriser::{self, Rendered};
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::PhysicalGaussians;
use crate::data::{FlowPrior, TrainingView};
use crate::method::{Base, Moment, Step, too_large};
use crate::model::Variables;

/// A Gaussian farther than this share of the depth from its pixel's surface is occluded by it or not part of it.
const ON_SURFACE: f64 = 0.05;
/// Depth and flow are interpolated between neighbouring pixels that differ by less than this share.
const SAMPLING: Sampling = Sampling::NearestAcrossEdges { relative: 0.1 };

pointwise! {
    /// y = depth / alpha, the expected depth, where alpha > least; otherwise `unknown`.
    fn expected_depth(depth, alpha) with(least, unknown) -> y {
        return select(unknown, depth / alpha, alpha > least);
    }
    gradients(dy) {
        depth: { return select(0.0, dy / alpha, alpha > least); }
        alpha: { return select(0.0, -dy * y / alpha, alpha > least); }
    }

    /// y = weight where |depth − surface| < share·surface, otherwise 0.
    fn on_surface(weight, depth, surface) with(share) -> y {
        return select(0.0, weight, abs(depth - surface) < share * surface);
    }
    gradients(dy) {
        weight: { return select(0.0, dy, abs(depth - surface) < share * surface); }
        depth: { return 0.0; }
        surface: { return 0.0; }
    }
}

/// M points as seen in a view.
pub(crate) struct ProjectedPoints<T: Real> {
    device: Device,
    /// Pixel positions [M, 2], px.
    pixels: Tensor<T>,
    /// View-space depth z of the surface at those pixels, [M].
    surface_depths: Tensor<T>,
    /// [M] mask: 1 where the point counts and lies on that surface, otherwise 0.
    visible: Tensor<T>,
}

/// Observed displacements per frame, from optical flow or exact velocities.
pub(crate) struct Observed<T: Real> {
    device: Device,
    /// [M, 3] in world space, scene units per frame; 0 where unobserved.
    pub displacements: Tensor<T>,
    /// [M] weights; 0 where unobserved.
    pub weights: Tensor<T>,
}

/// Expected depth Σwz / Σw [H, W] of a render with depth; NaN where it covers no more than `min_coverage`.
pub(crate) fn surface_depth<T: Real>(tape: &Tape<T>, rendered: &Rendered, min_coverage: f64) -> Tensor<T> {
    let mut child = tape.child();
    let sums = [rendered.depth.expect("rendered with depth"), rendered.alpha];
    let [depth, alpha] = sums.map(|var| child.constant(tape.value(var).clone()));
    let expected = expected_depth(&mut child, depth, alpha, min_coverage, f64::NAN);
    child.value(expected).clone()
}

impl<T: Real> ProjectedPoints<T> {
    /// Projects points [M, 3] (world) with weights [M] into an image with surface depths [H, W].
    pub(crate) fn of(
        device: Device,
        [points, weights]: [&Tensor<T>; 2],
        camera: &PinholeCamera,
        near_view: f64,
        surface_depth: Tensor<T>,
    ) -> Self {
        let mut tape = Tape::new(device);
        let [points, weights] = [points, weights].map(|tensor| tape.constant(tensor.clone()));
        let PointsInImage { pixels, depths } = project_points(&mut tape, points, camera, near_view);
        let surface = tape.constant(surface_depth);
        let Sampled { values, valid } = lookup(&mut tape, surface, pixels, SAMPLING);
        let count = tape.value(depths).len();
        let surface_depths = reshape(&mut tape, values, [count]);
        let counts = mul(&mut tape, valid, weights);
        let visible = on_surface(&mut tape, counts, depths, surface_depths, ON_SURFACE);
        let [pixels, surface_depths, visible] = [pixels, surface_depths, visible].map(|var| tape.value(var).clone());
        Self { device, pixels, surface_depths, visible }
    }
}

/// [H, W, 3] exact displacements per frame, scene units: velocity times the frame's duration.
pub(crate) fn displacement_map<T: Real>(velocity: &VelocityMap, frame_secs: f64) -> Tensor<T> {
    let per_frame = |value: &f32| T::from_f64(f64::from(*value) * frame_secs);
    let values = velocity.velocity_world.as_flattened().iter().map(per_frame).collect();
    Tensor::from_vec([velocity.height as usize, velocity.width as usize, 3], values)
}

/// Optical flow as a tensor [H, W, 2], px.
pub(crate) fn flow_map<T: Real>(flow: &FlowMap) -> Tensor<T> {
    let values = flow.flow_px.as_flattened().iter().map(|&value| T::from_f64(f64::from(value))).collect();
    Tensor::from_vec([flow.height as usize, flow.width as usize, 2], values)
}

/// Exact displacements per frame (eq 4), sampled from their map.
pub(crate) fn true_displacements<T: Real>(projected: &ProjectedPoints<T>, map: &Tensor<T>) -> Observed<T> {
    let mut tape = Tape::new(projected.device);
    let map = tape.constant(map.clone());
    let [pixels, visible] = [&projected.pixels, &projected.visible].map(|tensor| tape.constant(tensor.clone()));
    let Sampled { values, valid } = lookup(&mut tape, map, pixels, SAMPLING);
    Observed::where_all(tape, values, &[visible, valid])
}

/// Displacements per frame from optical flow (eq 2): unprojects each pixel before and after the flow at the rendered
/// depths; the views are `frames` frames apart.
pub(crate) fn flow_displacements<T: Real>(
    projected: &ProjectedPoints<T>,
    [camera, camera_to]: [&PinholeCamera; 2],
    [map, surface_depth_to]: [&Tensor<T>; 2],
    frames: f64,
) -> Observed<T> {
    let mut tape = Tape::new(projected.device);
    let given = [map, &projected.pixels, &projected.surface_depths, &projected.visible, surface_depth_to];
    let [map, pixels, depths, visible, surface_to] = given.map(|tensor| tape.constant(tensor.clone()));
    let shift = lookup(&mut tape, map, pixels, SAMPLING);
    let pixels_to = add(&mut tape, pixels, shift.values);
    let depths_to = lookup(&mut tape, surface_to, pixels_to, SAMPLING);
    let before = unproject(&mut tape, pixels, depths, camera);
    let after = unproject(&mut tape, pixels_to, depths_to.values, camera_to);
    let displacement = sub(&mut tape, after, before);
    let per_frame = scale(&mut tape, displacement, 1.0 / frames);
    Observed::where_all(tape, per_frame, &[visible, shift.valid, depths_to.valid])
}

impl<T: Real> Observed<T> {
    /// Displacements from a tape, with weight 1 where all conditions [M] are 1; otherwise displacement and weight are
    /// 0.
    fn where_all(mut tape: Tape<T>, displacements: Var, conditions: &[Var]) -> Self {
        let both = |a: Var, &b: &Var| mul(&mut tape, a, b);
        let weights = conditions[1..].iter().fold(conditions[0], both);
        let displacements = keep_rows(&mut tape, displacements, weights);
        let [displacements, weights] = [displacements, weights].map(|var| tape.value(var).clone());
        Self { device: tape.device(), displacements, weights }
    }

    /// The median length of the observed displacements, multiplied by `times`: [1], scene units per frame; 0 without
    /// observations.
    pub(crate) fn median_length(&self, times: f64) -> Tensor<T> {
        let mut tape = Tape::new(self.device);
        let [displacements, weights] = [&self.displacements, &self.weights].map(|of| tape.constant(of.clone()));
        let lengths = norm(&mut tape, displacements);
        let median = median_where(&mut tape, lengths, weights);
        let median = scale(&mut tape, median, times);
        tape.value(median).clone()
    }

    /// Reweighted so that the gradient of the squared distance to `estimate` [M, 3] stays constant beyond the distance
    /// max(`limit` [1], `least`): one step of iteratively reweighted least squares for the Huber loss (1964).
    pub(crate) fn without_outliers(&self, estimate: &Tensor<T>, limit: &Tensor<T>, least: f64) -> Self {
        let mut tape = Tape::new(self.device);
        let seen = [estimate, &self.displacements, &self.weights, limit];
        let [estimate, displacements, weights, limit] = seen.map(|tensor| tape.constant(tensor.clone()));
        let count = tape.value(weights).len();
        let difference = sub(&mut tape, estimate, displacements);
        let distances = norm(&mut tape, difference);
        let limits = repeat_row(&mut tape, limit, count);
        // weight / max(distance / max(limit, least), 1).
        let excess = divide_rows(&mut tape, distances, limits, least);
        let weights = divide_rows(&mut tape, weights, excess, 1.0);
        let weights = reshape(&mut tape, weights, [count]);
        Self { device: self.device, displacements: self.displacements.clone(), weights: tape.value(weights).clone() }
    }
}

impl PhysicalGaussians {
    /// Whether a step on this view uses any observation; depth is rendered only then.
    pub(super) fn observes<T: Real>(&self, step: &Step<'_, T>, view: &TrainingView<T>) -> bool {
        self.velocity_of(step, view).is_some() || self.flow_of(step, view).is_some()
    }

    /// The exact velocities of a view, if known and needed.
    pub(super) fn velocity_of<'a, T: Real>(
        &self,
        step: &Step<'a, T>,
        view: &TrainingView<T>,
    ) -> Option<&'a VelocityMap> {
        let wanted = self.parts.true_displacement && view.time < 1.0;
        step.supplements.view(view.index).filter(|_| wanted)?.velocity.as_ref()
    }

    /// The optical flow of a view, if given and needed, if it points forward in time and if the view shows motion.
    pub(super) fn flow_of<'a, T: Real>(&self, step: &Step<'a, T>, view: &TrainingView<T>) -> Option<&'a FlowPrior> {
        let flow = step.supplements.view(view.index).filter(|_| self.parts.flow)?.flow.as_ref()?;
        let points_forward = step.scene.time_map.normalized(flow.time_to_secs) > view.time;
        (points_forward && !is_static(step, view)).then_some(flow)
    }

    /// Surface depths [H, W] of the view where the flow ends, rendered without gradients.
    pub(super) fn surface_at<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        time: f64,
        flow: &FlowPrior,
    ) -> anyhow::Result<Tensor<T>> {
        let mut child = step.tape.child();
        let constant = |(name, var): (&str, _)| (name.to_string(), child.constant(step.tape.value(var).clone()));
        let model = Variables::new(step.model.iter().map(constant).collect());
        let camera = PinholeCamera::from(&flow.camera_to);
        let moment = Moment { scene: step.scene, phase: step.phase, time, camera: &camera, sh_degree: step.sh_degree };
        let splats = self.base.splats(&mut child, &model, &moment)?;
        let rendered = rasteriser::render(&mut child, &splats, None, &camera, &step.raster).map_err(too_large)?;
        let surface = surface_depth(&child, &rendered, self.settings.min_coverage);
        step.tape.absorb(child);
        Ok(surface)
    }
}

/// Whether a view is known to show no motion.
fn is_static<T: Real>(step: &Step<'_, T>, view: &TrainingView<T>) -> bool {
    step.supplements.moving(view.index).is_some_and(|moving| moving.labels.iter().all(|&label| label == 0))
}
