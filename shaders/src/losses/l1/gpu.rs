//! The kernels of the L1 loss.

use crate::arrays::sums::total_of;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const L1: Kernel = Kernel { name: "l1", text: include_str!("l1.wgsl") };
const L1_BACKWARD: Kernel = Kernel { name: "l1 backward", text: include_str!("l1_bwd.wgsl") };

uniforms! {
    struct DistanceBlock as "Distance" {
        len: u32,
        factor: f32,
    }
}

/// Mean |render − target|: [1].
pub(super) fn l1<T: Real>(gpu: Gpu, render: &Tensor<T>, target: &Tensor<T>) -> Tensor<T> {
    let images = [render, target].map(|image| Binding::Read(image.on_gpu(gpu)));
    Tensor::from_gpu([1], total_of(gpu, &L1, &images, render.len(), 1.0 / render.len() as f32))
}

/// Its gradient with respect to the render.
pub(crate) fn l1_gradient<T: Real>(gpu: Gpu, render: &Tensor<T>, target: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, render.len());
    let read = [render, target, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let arrays = [&read[..], &[Binding::Write(&gradient)]].concat();
    let block = DistanceBlock { len: render.len() as u32, factor: 1.0 / render.len() as f32 };
    L1_BACKWARD.launch(gpu, &[], &block, &arrays, Groups::Over(render.len()));
    Tensor::from_gpu(render.shape(), gradient)
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    crate::arrays::sums::assert_valid_total(&L1);
    crate::gpu::layout_tests::assert_valid::<DistanceBlock>(&L1_BACKWARD, &[]);
}
