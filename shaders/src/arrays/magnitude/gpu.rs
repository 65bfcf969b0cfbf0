//! The search for the largest magnitudes: one launch and one readback for all tensors.

use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::Tensor;

const VALUES: usize = 16;

pub(super) const LARGEST: Grouped = Grouped {
    kernel: Kernel { name: "largest magnitude", text: include_str!("magnitude.wgsl") },
    shared: 1,
    arrays: &[ItemArray::read("values").of_bits()],
};

uniforms! {
    struct Constants as "Item" { count: u32, slot: u32 }
}

fn specialisation() -> [(&'static str, u32); 1] {
    [("VALUES", VALUES as u32)]
}

/// The largest magnitude in each of these tensors, which are in the memory of one GPU.
pub(super) fn largest_magnitudes(tensors: &[&Tensor<f32>]) -> Vec<f32> {
    let Some(gpu) = tensors.first().and_then(|tensor| tensor.gpu()) else { return Vec::new() };
    let largest = GpuArray::zeros(gpu, tensors.len());
    let mut items = Vec::new();
    for (slot, tensor) in tensors.iter().enumerate() {
        let constants = |count| Constants { count, slot: slot as u32 };
        let arrays = [Binding::Read(tensor.on_gpu(gpu))];
        items.extend(Item::in_parts(gpu, tensor.len(), WORKGROUP_SIZE * VALUES, &arrays, constants));
    }
    LARGEST.launch(gpu, &specialisation(), &[Binding::Write(&largest)], &items);
    let mut bits = vec![0.0_f32; tensors.len()];
    largest.read_into(&mut bits);
    bits
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::grouped::tests::assert_valid_grouped::<Constants>(&LARGEST, &specialisation());
}
