//! The kernels of totals and of the mean distance.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, ROW_SUM, uniforms};
use crate::sums::{self, GROUP, TOTAL_TEXT, total_of};
use crate::tape::{Real, Tensor};

const SPREAD: Kernel = Kernel { name: "total backward", text: &[include_str!("total_bwd.wgsl")] };

const L1: Kernel = Kernel { name: "l1", text: &[ROW_SUM, include_str!("l1.wgsl"), TOTAL_TEXT] };
const L1_BACKWARD: Kernel = Kernel { name: "l1 backward", text: &[include_str!("l1_bwd.wgsl")] };

uniforms! {
    struct DistanceBlock as "Distance" {
        len: u32,
        factor: f32,
    }
}

/// Mean |render − target|: [1].
pub fn l1<T: Real>(gpu: Gpu, render: &Tensor<T>, target: &Tensor<T>) -> Tensor<T> {
    let images = [render, target].map(|image| Binding::Read(image.on_gpu(gpu)));
    Tensor::from_gpu([1], total_of(gpu, &L1, &images, render.len(), 1.0 / render.len() as f32))
}

/// Its gradient by the render.
pub fn l1_gradient<T: Real>(gpu: Gpu, render: &Tensor<T>, target: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, render.len());
    let read = [render, target, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let arrays = [&read[..], &[Binding::Write(&gradient)]].concat();
    let block = DistanceBlock { len: render.len() as u32, factor: 1.0 / render.len() as f32 };
    L1_BACKWARD.launch(gpu, &[], &block, &arrays, render.len().div_ceil(GROUP));
    Tensor::from_gpu(render.shape(), gradient)
}

uniforms! {
    struct SpreadBlock as "Spread" {
        factor: f32,
    }
}

/// factor · the sum of all elements: [1].
pub fn total<T: Real>(gpu: Gpu, x: &Tensor<T>, factor: f64) -> Tensor<T> {
    Tensor::from_gpu([1], sums::total(gpu, x.on_gpu(gpu), factor as f32))
}

/// Its gradient, in the shape of x.
pub fn total_gradient<T: Real>(gpu: Gpu, x: &Tensor<T>, dy: &Tensor<T>, factor: f64) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, x.len());
    let block = SpreadBlock { factor: factor as f32 };
    let arrays = [Binding::Read(dy.on_gpu(gpu)), Binding::Write(&gradient)];
    SPREAD.launch(gpu, &[], &block, &arrays, x.len().div_ceil(GROUP));
    Tensor::from_gpu(x.shape(), gradient)
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    crate::gpu::layout::assert_valid::<SpreadBlock>(&SPREAD, &[]);
    crate::sums::assert_valid_total(&L1);
    crate::gpu::layout::assert_valid::<DistanceBlock>(&L1_BACKWARD, &[]);
}
