//! The median of some elements on a GPU, by sorting them.

use crate::arrays::sort::sort;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const KEYS: Kernel = Kernel { name: "median, keys", text: include_str!("median_keys.wgsl") };
const MEDIAN: Kernel = Kernel { name: "median", text: include_str!("median.wgsl") };

uniforms! {
    struct MedianBlock as "Median" {
        len: u32,
    }
}

/// The median of the elements whose flag is above 0: [1].
pub(super) fn median<T: Real>(gpu: Gpu, x: &Tensor<T>, flags: &Tensor<T>) -> Tensor<T> {
    let block = MedianBlock { len: x.len() as u32 };
    let (keys, median) = (GpuArray::new(gpu, x.len()), GpuArray::new(gpu, 1));
    let arrays = [Binding::Read(x.on_gpu(gpu)), Binding::Read(flags.on_gpu(gpu)), Binding::Write(&keys)];
    KEYS.launch(gpu, &[], &block, &arrays, Groups::Over(x.len()));
    let (sorted, _) = sort(gpu, &keys, u32::BITS);
    MEDIAN.launch(gpu, &[], &block, &[Binding::Read(&sorted), Binding::Write(&median)], 1);
    Tensor::from_gpu([1], median)
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    crate::gpu::layout_tests::assert_valid::<MedianBlock>(&KEYS, &[]);
    crate::gpu::layout_tests::assert_valid::<MedianBlock>(&MEDIAN, &[]);
}
