//! Sums of pairs of tensors on a GPU, in one launch.

use super::{Real, Tensor};
use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};

const SUMS: Grouped = Grouped {
    kernel: Kernel { name: "sums of pairs", text: include_str!("pair_sums.wgsl") },
    shared: 0,
    arrays: &[ItemArray::read("a"), ItemArray::read("b"), ItemArray::write("y")],
};

uniforms! {
    struct SumItem as "Item" { len: u32 }
}

/// The sum of every pair of tensors, which have equal shapes.
pub(crate) fn sums_on_gpu<T: Real>(gpu: Gpu, pairs: &[[&Tensor<T>; 2]]) -> Vec<Tensor<T>> {
    let sums: Vec<GpuArray> = pairs.iter().map(|[a, _]| GpuArray::new(gpu, a.len())).collect();
    let mut items = Vec::new();
    for ([a, b], sum) in pairs.iter().zip(&sums) {
        let arrays = [Binding::Read(a.on_gpu(gpu)), Binding::Read(b.on_gpu(gpu)), Binding::Write(sum)];
        items.extend(Item::in_parts(gpu, sum.len(), WORKGROUP_SIZE, &arrays, |len| SumItem { len }));
    }
    SUMS.launch(gpu, &[], &[], &items);
    pairs.iter().zip(sums).map(|([a, _], sum)| Tensor::from_gpu(a.shape(), sum)).collect()
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::grouped::tests::assert_valid_grouped::<SumItem>(&SUMS, &[]);
}
