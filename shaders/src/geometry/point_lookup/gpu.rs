//! The kernels between world and image, and of lookups.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::Sampling;
use super::camera_maps::{Pinhole, Project, Unproject};
use super::lookup::Lookup;
use crate::arrays::sort::{sort, starts};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor, upstream};

const PROJECT: Kernel = Kernel { name: "project points", text: include_str!("project.wgsl") };
const PROJECT_BACKWARD: Kernel = Kernel { name: "project points backward", text: include_str!("project_bwd.wgsl") };
const UNPROJECT: Kernel = Kernel { name: "unproject", text: include_str!("unproject.wgsl") };
const UNPROJECT_BACKWARD: Kernel = Kernel { name: "unproject backward", text: include_str!("unproject_bwd.wgsl") };

const LOOKUP: Kernel = Kernel { name: "lookup", text: include_str!("lookup.wgsl") };
const VALID: Kernel = Kernel { name: "lookup, validity", text: include_str!("lookup_valid.wgsl") };
const LOOKUP_BACKWARD: Kernel = Kernel { name: "lookup backward", text: include_str!("lookup_bwd.wgsl") };
const IMAGE_BACKWARD: Kernel = Kernel { name: "lookup backward, image", text: include_str!("lookup_image_bwd.wgsl") };

uniforms! {
    struct CameraBlock as "Camera" {
        rows: [[f32; 4]; 3],
        focal: [f32; 2],
        center: [f32; 2],
        near_view: f32,
        count: u32,
        padding: [f32; 2],
    }
}

uniforms! {
    struct LookupBlock as "Lookup" {
        width: u32,
        height: u32,
        channels: u32,
        count: u32,
        relative: f32,
    }
}

uniforms! {
    struct CornersBlock as "Corners" {
        len: u32,
        channels: u32,
    }
}

fn camera_block<T: Real>(camera: &Pinhole<T>, near_view: f64, count: usize) -> CameraBlock {
    let f = |value: T| value.to_f64() as f32;
    let row = |axis: usize| {
        let [x, y, z] = camera.rotation[axis].map(f);
        [x, y, z, f(camera.translation[axis])]
    };
    CameraBlock {
        rows: [row(0), row(1), row(2)],
        focal: camera.focal.map(f),
        center: camera.center.map(f),
        near_view: near_view as f32,
        count: count as u32,
        padding: [0.0; 2],
    }
}

impl<T: Real> Project<T> {
    fn block(&self, points: &Tensor<T>) -> CameraBlock {
        camera_block(&self.camera, self.near_view.to_f64(), points.rows())
    }

    /// Pixels and depths.
    pub(super) fn project_on_gpu(&self, gpu: Gpu, points: &Tensor<T>) -> Vec<Tensor<T>> {
        let count = points.rows();
        let (pixels, depths) = (GpuArray::new(gpu, 2 * count), GpuArray::new(gpu, count));
        let arrays = [Binding::Read(points.on_gpu(gpu)), Binding::Write(&pixels), Binding::Write(&depths)];
        PROJECT.launch(gpu, &[], &self.block(points), &arrays, Groups::Over(count));
        vec![Tensor::from_gpu([count, 2], pixels), Tensor::from_gpu([count], depths)]
    }

    /// The gradient of the points.
    pub(super) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        points: &Tensor<T>,
        output_grads: &[Option<&Tensor<T>>],
    ) -> Tensor<T> {
        let gradient = GpuArray::new(gpu, points.len());
        let (mask, by_output) = upstream(gpu, output_grads, points.on_gpu(gpu));
        let arrays = [&[Binding::Read(points.on_gpu(gpu))][..], &by_output, &[Binding::Write(&gradient)]].concat();
        let groups = Groups::Over(points.rows());
        PROJECT_BACKWARD.launch(gpu, &[("ARRIVING", mask)], &self.block(points), &arrays, groups);
        Tensor::from_gpu(points.shape(), gradient)
    }
}

impl<T: Real> Unproject<T> {
    /// The points.
    pub(super) fn unproject_on_gpu(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let count = inputs[1].len();
        let points = GpuArray::new(gpu, 3 * count);
        let read = [0, 1].map(|input| Binding::Read(inputs[input].on_gpu(gpu)));
        let arrays = [&read[..], &[Binding::Write(&points)]].concat();
        UNPROJECT.launch(gpu, &[], &camera_block(&self.camera, 0.0, count), &arrays, Groups::Over(count));
        Tensor::from_gpu([count, 3], points)
    }

    /// The gradients of pixels and depths.
    pub(super) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        d_points: &Tensor<T>,
    ) -> Vec<Option<Tensor<T>>> {
        let count = inputs[1].len();
        let gradients = [0, 1].map(|input| GpuArray::new(gpu, inputs[input].len()));
        let read = [inputs[0], inputs[1], d_points].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&read[..], &gradients.each_ref().map(Binding::Write)].concat();
        let groups = Groups::Over(count);
        UNPROJECT_BACKWARD.launch(gpu, &[], &camera_block(&self.camera, 0.0, count), &arrays, groups);
        gradients.into_iter().zip(inputs).map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}

impl Lookup {
    fn edges(&self) -> (&'static str, u32) {
        ("EDGES", u32::from(self.sampling != Sampling::Bilinear))
    }

    fn block(&self, count: usize) -> LookupBlock {
        let relative = match self.sampling {
            Sampling::Bilinear => 0.0,
            Sampling::NearestAcrossEdges { relative } => relative as f32,
        };
        let [width, height, channels, count] = [self.width, self.height, self.channels, count].map(|size| size as u32);
        LookupBlock { width, height, channels, count, relative }
    }

    /// [`Lookup::validity`] with kernels.
    pub(super) fn validity_on_gpu<T: Real>(&self, gpu: Gpu, image: &Tensor<T>, pixels: &Tensor<T>) -> Tensor<T> {
        let count = pixels.rows();
        let valid = GpuArray::new(gpu, count);
        let read = [image, pixels].map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays = [&read[..], &[Binding::Write(&valid)]].concat();
        VALID.launch(gpu, &[self.edges()], &self.block(count), &arrays, Groups::Over(count));
        Tensor::from_gpu([count], valid)
    }

    pub(super) fn values_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let count = inputs[1].rows();
        let values = GpuArray::new(gpu, count * self.channels);
        let read = [0, 1].map(|input| Binding::Read(inputs[input].on_gpu(gpu)));
        let arrays = [&read[..], &[Binding::Write(&values)]].concat();
        LOOKUP.launch(gpu, &[self.edges()], &self.block(count), &arrays, Groups::Over(count));
        Tensor::from_gpu([count, self.channels], values)
    }

    /// The gradients of the image, if requested, and of the positions.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        d_values: &Tensor<T>,
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let count = inputs[1].rows();
        let to_pixels = GpuArray::new(gpu, inputs[1].len());
        let [texels, weights] = [(); 2].map(|()| GpuArray::new(gpu, 4 * count));
        let read = [inputs[0], inputs[1], d_values].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&read[..], &[&to_pixels, &texels, &weights].map(Binding::Write)].concat();
        LOOKUP_BACKWARD.launch(gpu, &[self.edges()], &self.block(count), &arrays, Groups::Over(count));
        let to_image = needs[0].then(|| {
            // The number of texels encodes "no texel".
            let bits = (self.width * self.height).ilog2() + 1;
            let (sorted, corners) = sort(gpu, &texels, bits);
            let starts = starts(gpu, &sorted, self.width * self.height);
            let gradient = GpuArray::new(gpu, inputs[0].len());
            let [len, channels] = [gradient.len(), self.channels].map(|size| size as u32);
            let read = [&corners, &starts, &weights, d_values.on_gpu(gpu)].map(Binding::Read);
            let arrays = [&read[..], &[Binding::Write(&gradient)]].concat();
            let block = CornersBlock { len, channels };
            IMAGE_BACKWARD.launch(gpu, &[], &block, &arrays, Groups::Over(gradient.len()));
            Tensor::from_gpu(inputs[0].shape(), gradient)
        });
        vec![to_image, Some(Tensor::from_gpu(inputs[1].shape(), to_pixels))]
    }
}
