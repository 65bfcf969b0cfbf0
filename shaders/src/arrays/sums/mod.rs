//! Sums on a GPU, of rows and of all elements: block sums, then sums of block sums, in an order that depends on the sizes
//! alone.

#[cfg(test)]
mod tests;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, uniforms};

const ROWS: Kernel = Kernel { name: "sums of rows", text: include_str!("sums_of_rows.wgsl") };
const TOTAL: Kernel = Kernel { name: "total", text: include_str!("total_input.wgsl") };

/// Elements per workgroup of a total, and so of kernels that make terms of a total.
pub(crate) const BLOCK: usize = 4096;
/// All invocations of a workgroup share one sum.
pub(crate) const LANES: (&str, u32) = ("LANES", WORKGROUP_SIZE as u32);
/// The most rows that a single invocation adds in one pass.
const MOST_ROWS: usize = 1024;

uniforms! {
    struct RowsBlock as "Rows" {
        rows: u32,
        columns: u32,
        rows_per_block: u32,
    }
}

uniforms! {
    struct TotalBlock as "Total" {
        len: u32,
        factor: f32,
    }
}

/// The sum of the rows of x [rows, columns]: [columns].
pub(crate) fn over_rows(gpu: Gpu, x: &GpuArray, columns: usize) -> GpuArray {
    let rows = x.len() / columns.max(1);
    // As many blocks as rows per block.
    let rows_per_block = if rows <= MOST_ROWS { rows.max(1) } else { rows.isqrt() + 1 };
    let blocks = rows.div_ceil(rows_per_block).max(1);
    let constants = RowsBlock { rows: rows as u32, columns: columns as u32, rows_per_block: rows_per_block as u32 };
    let sums = GpuArray::new(gpu, blocks * columns);
    let arrays = [Binding::Read(x), Binding::Write(&sums)];
    ROWS.launch(gpu, &[], &constants, &arrays, Groups::Over(blocks * columns));
    if blocks == 1 { sums } else { over_rows(gpu, &sums, columns) }
}

/// factor · the sum of all elements: [1].
pub(crate) fn total(gpu: Gpu, x: &GpuArray, factor: f32) -> GpuArray {
    total_of(gpu, &TOTAL, &[Binding::Read(x)], x.len(), factor)
}

/// factor · the sum of `terms` terms, by a kernel that imports `total.wgsl` and computes each term from its arrays: [1].
pub(crate) fn total_of(gpu: Gpu, kernel: &Kernel, arrays: &[Binding], terms: usize, factor: f32) -> GpuArray {
    let blocks = terms.div_ceil(BLOCK).max(1);
    let is_last = blocks == 1;
    let sums = GpuArray::new(gpu, blocks);
    let constants = TotalBlock { len: terms as u32, factor: if is_last { factor } else { 1.0 } };
    let arrays = [&[Binding::Write(&sums)], arrays].concat();
    kernel.launch(gpu, &[LANES], &constants, &arrays, blocks);
    if is_last { sums } else { total(gpu, &sums, factor) }
}

/// Panics unless a kernel of [`total_of`] is valid.
#[cfg(test)]
pub(crate) fn assert_valid_total(kernel: &Kernel) {
    crate::gpu::layout_tests::assert_valid::<TotalBlock>(kernel, &[LANES]);
}
