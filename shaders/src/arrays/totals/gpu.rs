//! The kernels of totals.

use crate::arrays::sums;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const SPREAD: Kernel = Kernel { name: "total backward", text: include_str!("total_bwd.wgsl") };

uniforms! {
    struct SpreadBlock as "Spread" {
        factor: f32,
    }
}

/// factor · the sum of all elements: [1].
pub(super) fn total<T: Real>(gpu: Gpu, x: &Tensor<T>, factor: f64) -> Tensor<T> {
    Tensor::from_gpu([1], sums::total(gpu, x.on_gpu(gpu), factor as f32))
}

/// Its gradient, in the shape of x.
pub(crate) fn total_gradient<T: Real>(gpu: Gpu, x: &Tensor<T>, dy: &Tensor<T>, factor: f64) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, x.len());
    let block = SpreadBlock { factor: factor as f32 };
    let arrays = [Binding::Read(dy.on_gpu(gpu)), Binding::Write(&gradient)];
    SPREAD.launch(gpu, &[], &block, &arrays, Groups::Over(x.len()));
    Tensor::from_gpu(x.shape(), gradient)
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::layout_tests::assert_valid::<SpreadBlock>(&SPREAD, &[]);
}
