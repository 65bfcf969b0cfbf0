//! Normalisation of rows of any width on a GPU.

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const FORWARD: Kernel = Kernel { name: "normalize", text: include_str!("normalize.wgsl") };
const BACKWARD: Kernel = Kernel { name: "normalize backward", text: include_str!("normalize_bwd.wgsl") };

uniforms! {
    struct LengthsBlock as "Lengths" {
        rows: u32,
        columns: u32,
        epsilon: f32,
    }
}

/// Runs a kernel for the rows of arrays that are all of one shape.
fn launch(gpu: Gpu, kernel: &Kernel, [rows, columns]: [usize; 2], epsilon: f64, arrays: &[Binding]) {
    let lanes = lanes_for(columns);
    let block = LengthsBlock { rows: rows as u32, columns: columns as u32, epsilon: epsilon as f32 };
    kernel.launch(gpu, &[("LANES", lanes as u32)], &block, arrays, Groups::Over(rows * lanes));
}

/// x / max(‖x‖, ε) of every row.
pub(super) fn normalize<T: Real>(gpu: Gpu, x: &Tensor<T>, epsilon: f64) -> Tensor<T> {
    let (y, shape) = (GpuArray::new(gpu, x.len()), [x.rows(), x.row_len()]);
    launch(gpu, &FORWARD, shape, epsilon, &[Binding::Read(x.on_gpu(gpu)), Binding::Write(&y)]);
    Tensor::from_gpu(shape, y)
}

/// Its gradient.
pub(crate) fn normalize_gradient<T: Real>(gpu: Gpu, [x, y, dy]: [&Tensor<T>; 3], epsilon: f64) -> Tensor<T> {
    let dx = GpuArray::new(gpu, x.len());
    let read = [x, y, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let arrays = [&read[..], &[Binding::Write(&dx)]].concat();
    launch(gpu, &BACKWARD, [x.rows(), x.row_len()], epsilon, &arrays);
    Tensor::from_gpu(x.shape(), dx)
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout_tests::assert_valid;
    for lanes in [1, 32, 256] {
        assert_valid::<LengthsBlock>(&FORWARD, &[("LANES", lanes)]);
        assert_valid::<LengthsBlock>(&BACKWARD, &[("LANES", lanes)]);
    }
}
