//! The kernel of the mean.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::sums::{GROUP, total};
use crate::tape::{Real, Tensor};

const SPREAD: Kernel = Kernel { name: "mean backward", text: &[include_str!("mean_bwd.wgsl")] };

uniforms! {
    struct SpreadBlock as "Spread" {
        factor: f32,
    }
}

/// The mean of all elements: [1].
pub fn mean<T: Real>(gpu: Gpu, x: &Tensor<T>) -> Tensor<T> {
    Tensor::from_gpu([1], total(gpu, x.on_gpu(gpu), 1.0 / x.len() as f32))
}

/// Its gradient, in the shape of x.
pub fn mean_gradient<T: Real>(gpu: Gpu, x: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, x.len());
    let block = SpreadBlock { factor: 1.0 / x.len() as f32 };
    let arrays = [Binding::Read(dy.on_gpu(gpu)), Binding::Write(&gradient)];
    SPREAD.launch(gpu, &[], &block, &arrays, x.len().div_ceil(GROUP));
    Tensor::from_gpu(x.shape(), gradient)
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::layout::assert_valid::<SpreadBlock>(&SPREAD, &[]);
}
