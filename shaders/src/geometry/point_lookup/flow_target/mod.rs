//! Targets of the points of a view under its optical flow (KineticGS equations 2 and 6).
//!
//! A point is visible if the view's depth agrees with its own. Its target is the back-projection of the pixel at the end of the
//! flow, with the depth there. If that depth is unknown, only the ray is known, and the target is the point on the ray with
//! the depth of the original point. Maps are read at the nearest pixel: interpolation would mix surfaces.

mod gpu;
#[cfg(test)]
mod tests;

use super::PinholeCamera;
use super::camera_maps::Pinhole;
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// A point is seen where its depth differs from the view's by less than this share.
pub(crate) const DEPTH_TOLERANCE: f64 = 0.05;

/// Depth and flow of one view.
#[derive(Clone, Debug)]
pub struct FlowMaps<T: Real> {
    /// The camera of the maps.
    pub camera: PinholeCamera,
    /// [H, W] z in view space, scene units; unknown where not positive or not finite.
    pub depth: Tensor<T>,
    /// [H, W, 2] px; unknown where not finite.
    pub flow: Tensor<T>,
    /// The camera at the end of the flow.
    pub camera_to: PinholeCamera,
    /// [H', W'] z in view space at the end of the flow, if known.
    pub depth_to: Option<Tensor<T>>,
}

/// The target positions of N points at the end of the flow; no gradient flows to them.
#[derive(Clone, Copy, Debug)]
pub struct FlowTargets {
    /// [N, 3] world; a point on the ray if only the ray is known; 0 for invisible points.
    pub positions: Var,
    /// [N, 3] the unconstrained direction: the unit vector of the ray, or zero.
    pub free: Var,
    /// [N, 1] 1 for visible points with known flow, otherwise 0.
    pub seen: Var,
}

/// The targets of points [N, 3] in the world under the flow. Computed in f64, on a GPU in f32.
pub fn flow_targets<T: Real>(tape: &mut Tape<T>, points_world: Var, maps: &FlowMaps<T>) -> FlowTargets {
    let [height, width] = maps.depth.shape() else { panic!("flow_targets: depth must be [H, W]") };
    assert_eq!(maps.flow.shape(), [*height, *width, 2], "flow_targets: flow must be [H, W, 2] as depth is [H, W]");
    assert_eq!(tape.value(points_world).row_len(), 3, "flow_targets: points must be [N, 3]");
    let outputs = tape.apply(FlowTarget { maps: maps.clone() }, &[points_world]);
    FlowTargets { positions: outputs[0], free: outputs[1], seen: outputs[2] }
}

struct FlowTarget<T: Real> {
    maps: FlowMaps<T>,
}

/// The row of a point: position, free direction, whether it is seen.
type Row = ([f64; 3], [f64; 3], f64);

impl<T: Real> FlowTarget<T> {
    /// The target of one point; `None` if it is invisible or its flow is unknown.
    fn target(&self, [camera, camera_to]: &[Pinhole<f64>; 2], point: [f64; 3]) -> Option<Row> {
        let [x, y, depth] = camera.view_from_world(&point);
        let pixel = [camera.focal[0] * x / depth + camera.center[0], camera.focal[1] * y / depth + camera.center[1]];
        let at = Some(pixel).filter(|_| depth > 0.0).and_then(|pixel| texel(&self.maps.depth, pixel))?;
        let surface = known_depth(&self.maps.depth, at)?;
        let flow = &self.maps.flow.as_slice()[2 * at..2 * at + 2];
        if !(flow[0].is_finite() && flow[1].is_finite() && (depth - surface).abs() <= DEPTH_TOLERANCE * surface) {
            return None;
        }
        let arrival = [pixel[0] + flow[0].to_f64(), pixel[1] + flow[1].to_f64()];
        let depth_to = self.maps.depth_to.as_ref().and_then(|map| known_depth(map, texel(map, arrival)?));
        let ray = camera_to.ray_view(&arrival);
        let along = |depth: f64| [0, 1, 2].map(|axis| depth * ray[axis] - camera_to.translation[axis]);
        let position = camera_to.rotated_to_world(&along(depth_to.unwrap_or(surface)));
        let direction = camera_to.rotated_to_world(&ray);
        let length = direction.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
        let free = if depth_to.is_some() { [0.0; 3] } else { direction.map(|axis| axis / length) };
        Some((position, free, 1.0))
    }
}

/// The index of the pixel of a map [H, W] that contains a position; `None` outside the image.
fn texel<T: Real>(map: &Tensor<T>, [x, y]: [f64; 2]) -> Option<usize> {
    let (height, width) = (map.shape()[0], map.shape()[1]);
    let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
    inside.then(|| y as usize * width + x as usize)
}

fn known_depth<T: Real>(map: &Tensor<T>, at: usize) -> Option<f64> {
    let depth = map.as_slice()[at].to_f64();
    (depth > 0.0 && depth.is_finite()).then_some(depth)
}

impl<T: Real> Op<T> for FlowTarget<T> {
    fn name(&self) -> &'static str {
        "flow_targets"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let cameras = [&self.maps.camera, &self.maps.camera_to].map(Pinhole::<f64>::new);
        let points = inputs[0].as_slice().as_chunks::<3>().0;
        let (mut positions, mut free, mut seen) = (Vec::new(), Vec::new(), Vec::new());
        for point in points {
            let row = self.target(&cameras, point.map(T::to_f64)).unwrap_or_default();
            positions.extend(row.0.map(T::from_f64));
            free.extend(row.1.map(T::from_f64));
            seen.push(T::from_f64(row.2));
        }
        let count = points.len();
        let of_three = [positions, free].map(|rows| Tensor::from_vec([count, 3], rows));
        of_three.into_iter().chain([Tensor::from_vec([count, 1], seen)]).collect()
    }

    fn backward(&mut self, _pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![None]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for FlowTarget<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(gpu::targets(gpu, &self.maps, inputs[0]))
    }

    fn backward_gpu(&mut self, _gpu: Gpu, _pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![None]
    }
}
