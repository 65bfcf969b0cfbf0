//! The search for the largest, a launch per tensor and one readback for all.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::tape::Tensor;

/// Values per workgroup and per invocation.
const GROUP: usize = 256;
const VALUES: usize = 16;

pub(super) const LARGEST: Kernel = Kernel { name: "largest magnitude", text: &[include_str!("magnitude.wgsl")] };

uniforms! {
    struct Constants as "Constants" { count: u32, slot: u32 }
}

pub(super) fn specialisation() -> [(&'static str, u32); 1] {
    [("VALUES", VALUES as u32)]
}

/// As [`super::largest_magnitudes`] for tensors in the memory of a GPU, [count]; they stay there.
pub(super) fn largest(gpu: Gpu, tensors: &[&Tensor<f32>]) -> GpuArray {
    let largest = GpuArray::zeros(gpu, tensors.len());
    for (slot, tensor) in tensors.iter().enumerate() {
        let constants = Constants { count: tensor.len() as u32, slot: slot as u32 };
        let arrays = [Binding::Read(tensor.on_gpu(gpu)), Binding::Write(&largest)];
        LARGEST.launch(gpu, &specialisation(), &constants, &arrays, tensor.len().div_ceil(GROUP * VALUES));
    }
    largest
}

/// The same in the memory of the host.
pub(super) fn largest_magnitudes(tensors: &[&Tensor<f32>]) -> Vec<f32> {
    let Some(gpu) = tensors.first().and_then(|tensor| tensor.gpu()) else { return Vec::new() };
    let mut bits = vec![0.0_f32; tensors.len()];
    largest(gpu, tensors).read_into(&mut bits);
    bits
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    use crate::gpu::layout::{check_layout, validate};
    let source = LARGEST.source(&specialisation());
    validate(&source).unwrap_or_else(|error| panic!("{error}"));
    check_layout::<Constants>(&source).unwrap_or_else(|error| panic!("{error}"));
}
