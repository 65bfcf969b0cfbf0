//! The kernels of layer normalisation.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use crate::gpu::column_sums::Terms;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const STANDARDIZE: Kernel = Kernel { name: "standardize", text: include_str!("layer_norm.wgsl") };
const STANDARDIZE_BACKWARD: Kernel = Kernel { name: "standardize backward", text: include_str!("layer_norm_bwd.wgsl") };
const AFFINE: Kernel = Kernel { name: "affine columns", text: include_str!("affine.wgsl") };
const AFFINE_TERMS: Kernel = Kernel { name: "affine columns backward", text: include_str!("affine_terms.wgsl") };

uniforms! {
    struct NormBlock as "Norm" {
        rows: u32,
        columns: u32,
    }
}

uniforms! {
    struct AffineBlock as "Affine" {
        len: u32,
        columns: u32,
    }
}

/// Runs a kernel for the rows of arrays in the shape of x.
fn launch<T: Real>(gpu: Gpu, kernel: &Kernel, x: &Tensor<T>, arrays: &[Binding]) {
    let (rows, columns) = (x.rows(), x.row_len());
    let lanes = lanes_for(columns);
    let block = NormBlock { rows: rows as u32, columns: columns as u32 };
    kernel.launch(gpu, &[("LANES", lanes as u32)], &block, arrays, Groups::Over(rows * lanes));
}

pub(super) fn standardize<T: Real>(gpu: Gpu, x: &Tensor<T>) -> Tensor<T> {
    let y = GpuArray::new(gpu, x.len());
    launch(gpu, &STANDARDIZE, x, &[Binding::Read(x.on_gpu(gpu)), Binding::Write(&y)]);
    Tensor::from_gpu([x.rows(), x.row_len()], y)
}

pub(super) fn standardize_backward<T: Real>(gpu: Gpu, [x, y, dy]: [&Tensor<T>; 3]) -> Tensor<T> {
    let dx = GpuArray::new(gpu, x.len());
    let read = [x, y, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    launch(gpu, &STANDARDIZE_BACKWARD, x, &[&read[..], &[Binding::Write(&dx)]].concat());
    Tensor::from_gpu(x.shape(), dx)
}

/// x·scale + offset, or without offset where `is_backward`.
fn affine<T: Real>(gpu: Gpu, [x, scale, offset]: [&Tensor<T>; 3], is_backward: bool) -> Tensor<T> {
    let y = GpuArray::new(gpu, x.len());
    let read = [x, scale, offset].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let arrays = [&read[..], &[Binding::Write(&y)]].concat();
    let block = AffineBlock { len: x.len() as u32, columns: x.row_len() as u32 };
    AFFINE.launch(gpu, &[("BACKWARD", u32::from(is_backward))], &block, &arrays, Groups::Over(x.len()));
    Tensor::from_gpu(x.shape(), y)
}

pub(super) fn affine_columns<T: Real>(gpu: Gpu, inputs: [&Tensor<T>; 3]) -> Tensor<T> {
    affine(gpu, inputs, false)
}

/// The gradients of all inputs.
pub(super) fn affine_columns_backward<T: Real>(
    gpu: Gpu,
    [x, scale, offset]: [&Tensor<T>; 3],
    dy: &Tensor<T>,
) -> Vec<Option<Tensor<T>>> {
    let arrays = [x, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let (rows, columns) = (x.rows(), x.row_len());
    let terms = Terms { kernel: &AFFINE_TERMS, specialisation: &[], arrays: &arrays, rows, columns };
    let [to_scale, to_offset] = terms.sums(gpu).map(|sums| Tensor::from_gpu([columns], sums));
    vec![Some(affine(gpu, [dy, scale, offset], true)), Some(to_scale), Some(to_offset)]
}
