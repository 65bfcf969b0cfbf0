//! Transforms between world and image.

use super::{NOWHERE, PinholeCamera};
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tensor, exactly};

/// A camera in the working precision.
pub(super) struct Pinhole<T> {
    pub focal: [T; 2],
    pub center: [T; 2],
    pub rotation: [[T; 3]; 3],
    pub translation: [T; 3],
}

impl<T: Real> Pinhole<T> {
    pub(super) fn new(camera: &PinholeCamera) -> Self {
        Self {
            focal: camera.focal.map(T::from_f64),
            center: camera.center.map(T::from_f64),
            rotation: camera.rotation.map(|row| row.map(T::from_f64)),
            translation: camera.translation.map(T::from_f64),
        }
    }

    /// R·X + t.
    pub(super) fn view_from_world(&self, point: &[T; 3]) -> [T; 3] {
        [0, 1, 2].map(|row| self.translation[row] + (0..3).map(|axis| self.rotation[row][axis] * point[axis]).sum())
    }

    /// R·d.
    fn rotated_to_view(&self, direction: &[T; 3]) -> [T; 3] {
        [0, 1, 2].map(|row| (0..3).map(|axis| self.rotation[row][axis] * direction[axis]).sum())
    }

    /// Rᵀ·d.
    pub(super) fn rotated_to_world(&self, direction: &[T; 3]) -> [T; 3] {
        [0, 1, 2].map(|axis| (0..3).map(|row| self.rotation[row][axis] * direction[row]).sum())
    }

    /// The direction through a pixel position, scaled to z = 1.
    pub(super) fn ray_view(&self, pixel: &[T; 2]) -> [T; 3] {
        let [x, y] = [0, 1].map(|axis| (pixel[axis] - self.center[axis]) / self.focal[axis]);
        [x, y, T::ONE]
    }
}

/// Points [N, 3] → pixels [N, 2], depths [N].
pub(crate) struct Project<T> {
    pub camera: Pinhole<T>,
    pub near_view: T,
}

impl<T: Real> Project<T> {
    pub(super) fn new(camera: &PinholeCamera, near_view: f64) -> Self {
        Self { camera: Pinhole::new(camera), near_view: T::from_f64(near_view) }
    }
}

impl<T: Real> Op<T> for Project<T> {
    fn name(&self) -> &'static str {
        "project_points"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (points, count) = (inputs[0].as_slice().as_chunks::<3>().0, inputs[0].rows());
        let (mut pixels, mut depths) = (Vec::with_capacity(2 * count), Vec::with_capacity(count));
        let Pinhole { focal, center, .. } = self.camera;
        for point in points {
            let [x, y, z] = self.camera.view_from_world(point);
            let in_front = z > self.near_view;
            let pixel = [focal[0] * x / z + center[0], focal[1] * y / z + center[1]];
            pixels.extend(if in_front { pixel } else { [T::from_f64(NOWHERE); 2] });
            depths.push(z);
        }
        vec![Tensor::from_vec([count, 2], pixels), Tensor::from_vec([count], depths)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        let [fx, fy] = self.camera.focal;
        let mut gradient = Vec::with_capacity(inputs[0].len());
        for (index, point) in inputs[0].as_slice().as_chunks::<3>().0.iter().enumerate() {
            let [x, y, z] = self.camera.view_from_world(point);
            let mut d_view = [T::ZERO, T::ZERO, output_grads[1].map_or(T::ZERO, |depth| depth.as_slice()[index])];
            if let (Some(pixels), true) = (output_grads[0], z > self.near_view) {
                // u = f·x/z + c: ∂u/∂x = f/z and ∂u/∂z = −f·x/z².
                let row = pixels.row(index);
                let (dx, dy) = (row[0] * fx / z, row[1] * fy / z);
                d_view = [dx, dy, d_view[2] - (dx * x + dy * y) / z];
            }
            gradient.extend(self.camera.rotated_to_world(&d_view));
        }
        vec![Some(Tensor::from_vec(inputs[0].shape(), gradient))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Project<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(self.project_on_gpu(gpu, inputs[0]))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        vec![Some(self.backward_on_gpu(gpu, inputs[0], output_grads))]
    }
}

/// Pixels [N, 2], depths [N] → points [N, 3].
pub(crate) struct Unproject<T> {
    pub camera: Pinhole<T>,
}

impl<T: Real> Unproject<T> {
    pub(super) fn new(camera: &PinholeCamera) -> Self {
        Self { camera: Pinhole::new(camera) }
    }
}

impl<T: Real> Op<T> for Unproject<T> {
    fn name(&self) -> &'static str {
        "unproject"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [pixels, depths] = inputs else { unreachable!("two inputs") };
        let mut points = Vec::with_capacity(3 * depths.len());
        for (pixel, &depth) in pixels.as_slice().as_chunks::<2>().0.iter().zip(depths.as_slice()) {
            let ray = self.camera.ray_view(pixel);
            let from_center = [0, 1, 2].map(|axis| depth * ray[axis] - self.camera.translation[axis]);
            points.extend(self.camera.rotated_to_world(&from_center));
        }
        vec![Tensor::from_vec([depths.len(), 3], points)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let ([pixels, depths], d_points) = (exactly(pass.inputs), pass.dy());
        let (mut d_pixels, mut d_depths) = (Vec::with_capacity(pixels.len()), Vec::with_capacity(depths.len()));
        let rows = pixels.as_slice().as_chunks::<2>().0.iter().zip(d_points.as_slice().as_chunks::<3>().0);
        for ((pixel, d_point), &depth) in rows.zip(depths.as_slice()) {
            let d_view = self.camera.rotated_to_view(d_point);
            let ray = self.camera.ray_view(pixel);
            d_pixels.extend([0, 1].map(|axis| d_view[axis] * depth / self.camera.focal[axis]));
            d_depths.push((0..3).map(|axis| d_view[axis] * ray[axis]).sum());
        }
        vec![Some(Tensor::from_vec(pixels.shape(), d_pixels)), Some(Tensor::from_vec(depths.shape(), d_depths))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Unproject<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.unproject_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        self.backward_on_gpu(gpu, pass.inputs, pass.dy())
    }
}
