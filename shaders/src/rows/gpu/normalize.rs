//! Rows of length one on a GPU, however wide.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, ROW_SUM, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const LENGTH: &str = include_str!("length.wgsl");
const FORWARD: Kernel = Kernel { name: "normalize", text: &[ROW_SUM, LENGTH, include_str!("normalize.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "normalize backward", text: &[ROW_SUM, LENGTH, include_str!("normalize_bwd.wgsl")] };

/// Invocations per workgroup.
const GROUP: usize = 256;

uniforms! {
    struct LengthsBlock as "Lengths" {
        rows: u32,
        columns: u32,
        epsilon: f32,
    }
}

/// Constants of specialisation, block of constants and workgroups for the rows of x.
fn rows_of<T: Real>(x: &Tensor<T>, epsilon: f64) -> ([(&'static str, u32); 1], LengthsBlock, usize) {
    let lanes = lanes_for(x.row_len());
    let block = LengthsBlock { rows: x.rows() as u32, columns: x.row_len() as u32, epsilon: epsilon as f32 };
    ([("LANES", lanes as u32)], block, (x.rows() * lanes).div_ceil(GROUP))
}

/// x / max(‖x‖, ε) of every row.
pub fn normalize<T: Real>(gpu: Gpu, x: &Tensor<T>, epsilon: f64) -> Tensor<T> {
    let y = GpuArray::new(gpu, x.len());
    let (lanes, block, groups) = rows_of(x, epsilon);
    FORWARD.launch(gpu, &lanes, &block, &[Binding::Read(x.on_gpu(gpu)), Binding::Write(&y)], groups);
    Tensor::from_gpu([x.rows(), x.row_len()], y)
}

/// Its gradient.
pub fn normalize_gradient<T: Real>(gpu: Gpu, [x, y, dy]: [&Tensor<T>; 3], epsilon: f64) -> Tensor<T> {
    let dx = GpuArray::new(gpu, x.len());
    let (lanes, block, groups) = rows_of(x, epsilon);
    let read = [x, y, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    BACKWARD.launch(gpu, &lanes, &block, &[&read[..], &[Binding::Write(&dx)]].concat(), groups);
    Tensor::from_gpu(x.shape(), dx)
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout::assert_valid;
    for lanes in [1, 32, 256] {
        assert_valid::<LengthsBlock>(&FORWARD, &[("LANES", lanes)]);
        assert_valid::<LengthsBlock>(&BACKWARD, &[("LANES", lanes)]);
    }
}
