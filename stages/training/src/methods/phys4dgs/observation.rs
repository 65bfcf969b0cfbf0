//! Motion of points as observed in images. Observations are constants: no gradient flows through them.

use scene::{FlowMap, VelocityMap};
use shaders::arrays::rows::{
    divide_rows, keep_rows, median_where, norm, normalize, repeat_row, reshape, row_dot, scale_rows,
};
use shaders::geometry::camera::PinholeCamera;
use shaders::geometry::point_lookup::{PointsInImage, Sampled, Sampling, lookup, project_points, unproject};
use shaders::pointwise;
use shaders::pointwise::{add, mul, scale, sub};
use shaders::rasteriser::Rendered;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::trajectories::where_below;
use crate::method::Step;

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
    near_view: f64,
    /// Pixel positions [M, 2], px.
    pixels: Tensor<T>,
    /// View-space depth z of the surface at those pixels, [M].
    surface_depths: Tensor<T>,
    /// [M] mask: 1 where the point counts and lies on that surface, otherwise 0.
    visible: Tensor<T>,
}

/// Observed displacements per frame, from optical flow or exact velocities.
#[derive(Clone)]
pub(crate) struct Observed<T: Real> {
    device: Device,
    /// [M, 3] in world space, scene units per frame; finite and without meaning where unobserved.
    pub displacements: Tensor<T>,
    /// [M] weights; 0 where unobserved.
    pub weights: Tensor<T>,
    /// [M, 3] unit vectors of the viewing rays; 0 where motion along the ray is observed as well as across it.
    pub rays: Tensor<T>,
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
        Self { device, near_view, pixels, surface_depths, visible }
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
    let rays = tape.constant(Tensor::zeros(tape.value(values).shape()));
    Observed::where_all(tape, [values, rays], &[visible, valid])
}

/// Where optical flow leads: the camera and the surface depths [H, W] there, the points moved by the model [M, 3]
/// (world), and the number of frames until then.
pub(crate) struct Arrival<'a, T: Real> {
    pub camera: &'a PinholeCamera,
    pub surface_depth: &'a Tensor<T>,
    pub moved: &'a Tensor<T>,
    pub frames: f64,
}

/// Displacements per frame from optical flow (eq 2): unprojects each pixel before and after the flow at the rendered
/// depths. A point is observed only if the surface at the end of the flow is its own, i.e. lies at its depth.
pub(crate) fn flow_displacements<T: Real>(
    projected: &ProjectedPoints<T>,
    camera: &PinholeCamera,
    map: &Tensor<T>,
    to: &Arrival<'_, T>,
) -> Observed<T> {
    let mut tape = Tape::new(projected.device);
    let given = [map, &projected.pixels, &projected.surface_depths, &projected.visible, to.surface_depth, to.moved];
    let [map, pixels, depths, visible, surface_to, moved] = given.map(|tensor| tape.constant(tensor.clone()));
    let shift = lookup(&mut tape, map, pixels, SAMPLING);
    let pixels_to = add(&mut tape, pixels, shift.values);
    let depths_to = lookup(&mut tape, surface_to, pixels_to, SAMPLING);
    let before = unproject(&mut tape, pixels, depths, camera);
    let after = unproject(&mut tape, pixels_to, depths_to.values, to.camera);
    let displacement = sub(&mut tape, after, before);
    let per_frame = scale(&mut tape, displacement, 1.0 / to.frames);
    let PointsInImage { depths: moved, .. } = project_points(&mut tape, moved, to.camera, projected.near_view);
    let count = tape.value(moved).len();
    let surface = reshape(&mut tape, depths_to.values, [count]);
    let stays = on_surface(&mut tape, visible, moved, surface, ON_SURFACE);
    let twice_as_far = scale(&mut tape, depths, 2.0);
    let behind = unproject(&mut tape, pixels, twice_as_far, camera);
    let rays = sub(&mut tape, behind, before);
    let rays = normalize(&mut tape, rays, 1e-12);
    Observed::where_all(tape, [per_frame, rays], &[stays, shift.valid, depths_to.valid])
}

impl<T: Real> Observed<T> {
    /// Displacements and rays from a tape, with weight 1 where all conditions [M] are 1; otherwise they and the
    /// weight are 0.
    fn where_all(mut tape: Tape<T>, vectors: [Var; 2], conditions: &[Var]) -> Self {
        let both = |a: Var, &b: &Var| mul(&mut tape, a, b);
        let weights = conditions[1..].iter().fold(conditions[0], both);
        let [displacements, rays] = vectors.map(|vectors| keep_rows(&mut tape, vectors, weights));
        let [displacements, weights, rays] = [displacements, weights, rays].map(|var| tape.value(var).clone());
        Self { device: tape.device(), displacements, weights, rays }
    }

    /// Observed changes: the observation `later` minus the observation `earlier`, where both exist.
    pub(crate) fn change([earlier, later]: [&Self; 2]) -> Self {
        let mut tape = Tape::new(earlier.device);
        let given = [&later.displacements, &earlier.displacements, &earlier.rays, &earlier.weights, &later.weights];
        let [after, before, rays, first, second] = given.map(|tensor| tape.constant(tensor.clone()));
        let difference = sub(&mut tape, after, before);
        Self::where_all(tape, [difference, rays], &[first, second])
    }

    /// Puts the displacements [M, 3] and the weights [M] on the tape as constants.
    pub(crate) fn constants(&self, step: &mut Step<'_, T>) -> (Var, Var) {
        (step.tape.detach_value(self.displacements.clone()), step.tape.detach_value(self.weights.clone()))
    }

    /// The median length of the observed displacements longer than `least`, multiplied by `times`: [1], scene units per
    /// frame; 0 without such observations. Shorter ones belong to static surfaces: in a mostly static scene, their
    /// median would make every motion an outlier.
    pub(crate) fn median_length(&self, least: f64, times: f64) -> Tensor<T> {
        let mut tape = Tape::new(self.device);
        let [displacements, weights] = [&self.displacements, &self.weights].map(|of| tape.constant(of.clone()));
        let (lengths, count) = (norm(&mut tape, displacements), tape.value(weights).len());
        let lengths = reshape(&mut tape, lengths, [count]);
        let still = where_below(&mut tape, lengths, weights, least);
        let moving = sub(&mut tape, weights, still);
        let median = median_where(&mut tape, lengths, moving);
        let median = scale(&mut tape, median, times);
        tape.value(median).clone()
    }

    /// Moves the displacements towards `estimate` [M, 3] so that the gradient of the squared distance is constant
    /// beyond the distance max(`limit` [1], `least`), as in the loss of Huber (1964). Smaller weights would have the
    /// same effect on a sum, but not on a mean, which is divided by the weights.
    pub(crate) fn without_outliers(&self, estimate: &Tensor<T>, limit: &Tensor<T>, least: f64) -> Self {
        let mut tape = Tape::new(self.device);
        let [estimate, displacements, limit] =
            [estimate, &self.displacements, limit].map(|tensor| tape.constant(tensor.clone()));
        let count = tape.value(displacements).rows();
        let difference = sub(&mut tape, estimate, displacements);
        let distances = norm(&mut tape, difference);
        let limits = repeat_row(&mut tape, limit, count);
        // difference / max(distance / max(limit, least), 1).
        let excess = divide_rows(&mut tape, distances, limits, least);
        let limited = divide_rows(&mut tape, difference, excess, 1.0);
        let displacements = sub(&mut tape, estimate, limited);
        Self { displacements: tape.value(displacements).clone(), ..self.clone() }
    }

    /// Moves the displacements along the rays towards `estimate` [M, 3] so that the gradient of the squared distance
    /// along a ray is multiplied by `trust`.
    pub(crate) fn trusting_depth(&self, estimate: &Tensor<T>, trust: f64) -> Self {
        let mut tape = Tape::new(self.device);
        let [estimate, displacements, rays] =
            [estimate, &self.displacements, &self.rays].map(|tensor| tape.constant(tensor.clone()));
        let difference = sub(&mut tape, estimate, displacements);
        let along = row_dot(&mut tape, difference, rays);
        let along = scale(&mut tape, along, 1.0 - trust);
        let shift = scale_rows(&mut tape, rays, along);
        let displacements = add(&mut tape, displacements, shift);
        Self { displacements: tape.value(displacements).clone(), ..self.clone() }
    }
}
