//! Upstream gradients as kernels read them.

use super::{Real, Tensor};
use crate::gpu::{Binding, Gpu, GpuArray};

/// The gradients of an operation's outputs: a bit mask of those present, and one binding each. A missing one is bound to
/// `placeholder`, which the kernel never reads.
pub(crate) fn upstream<'a, T: Real>(
    gpu: Gpu,
    gradients: &[Option<&'a Tensor<T>>],
    placeholder: &'a GpuArray,
) -> (u32, Vec<Binding<'a>>) {
    let mask =
        gradients.iter().enumerate().fold(0, |mask, (bit, gradient)| mask | u32::from(gradient.is_some()) << bit);
    let array = |gradient: &Option<&'a Tensor<T>>| gradient.map_or(placeholder, |gradient| gradient.on_gpu(gpu));
    (mask, gradients.iter().map(|gradient| Binding::Read(array(gradient))).collect())
}
