//! The update on a GPU: one launch per group, and nothing is read back. Values and moments are new arrays, because whoever
//! shares the old ones keeps them.

use super::{Coefficients, Group};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::tape::Tensor;

const ADAM: Kernel = Kernel { name: "adam", text: &[include_str!("adam.wgsl")] };

/// Elements per workgroup.
const GROUP: usize = 256;

uniforms! {
    struct AdamBlock as "Adam" {
        beta1: f32,
        beta2: f32,
        step_size: f32,
        second_moment_scale: f32,
        epsilon: f32,
    }
}

/// Updates a group whose step is counted already.
pub fn advance(gpu: Gpu, group: &mut Group, gradient: &Tensor<f32>, coefficients: Coefficients) {
    let Coefficients { beta1, beta2, step_size, second_moment_scale, epsilon } = coefficients;
    let block = AdamBlock { beta1, beta2, step_size, second_moment_scale, epsilon };
    let [values, first, second] = group.tensors();
    let read = [gradient, values, first, second].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let written = [(); 3].map(|()| GpuArray::new(gpu, gradient.len()));
    let arrays: Vec<Binding> = read.into_iter().chain(written.iter().map(Binding::Write)).collect();
    ADAM.launch(gpu, &[], &block, &arrays, gradient.len().div_ceil(GROUP));
    group.replace(written.map(|array| Tensor::from_gpu(gradient.shape(), array)));
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::layout::assert_valid::<AdamBlock>(&ADAM, &[]);
}
