//! Column sums of terms that an operation computes from its arrays: first over blocks of rows, then over blocks, in an
//! order that depends on the sizes alone.

use super::{Binding, Gpu, GpuArray, Kernel, columns_for, uniforms};

const TOTALS: Kernel = Kernel { name: "column totals", text: include_str!("column_totals.wgsl") };

/// The most blocks, and the fewest rows of each: few enough to be added by one workgroup, and enough to fill a GPU.
const MAX_BLOCKS: usize = 256;
const MIN_BLOCK_ROWS: usize = 64;
/// Columns per workgroup of the totals: 32 bytes are read at once.
const TOTALS_COLUMNS: usize = 8;
const COLUMNS_OF_TOTALS: (&str, u32) = ("COLUMNS", TOTALS_COLUMNS as u32);

uniforms! {
    struct SumsBlock as "Sums" {
        rows: u32,
        columns: u32,
        block_rows: u32,
    }
}

uniforms! {
    struct TotalsBlock as "Totals" {
        blocks: u32,
        columns: u32,
    }
}

/// The terms of an operation: two for every row and column.
pub(crate) struct Terms<'a> {
    /// Imports `column_sums.wgsl`.
    pub kernel: &'a Kernel,
    /// Constants of its specialisation besides COLUMNS.
    pub(crate) specialisation: &'a [(&'static str, u32)],
    /// The arrays that the terms are computed from.
    pub arrays: &'a [Binding<'a>],
    pub rows: usize,
    pub columns: usize,
}

impl Terms<'_> {
    /// The sums over blocks of rows, [blocks, 2, columns], and the number of blocks.
    pub(crate) fn block_sums(&self, gpu: Gpu) -> (GpuArray, usize) {
        let block_rows = self.rows.div_ceil(MAX_BLOCKS).max(MIN_BLOCK_ROWS);
        let blocks = self.rows.div_ceil(block_rows);
        let sums = GpuArray::new(gpu, blocks * 2 * self.columns);
        let [rows, columns, block_rows] = [self.rows, self.columns, block_rows].map(|size| size as u32);
        let tile = columns_for(self.columns);
        let specialisation = [&[("COLUMNS", tile as u32)], self.specialisation].concat();
        let arrays = [&[Binding::Write(&sums)], self.arrays].concat();
        let groups = blocks * self.columns.div_ceil(tile);
        self.kernel.launch(gpu, &specialisation, &SumsBlock { rows, columns, block_rows }, &arrays, groups);
        (sums, blocks)
    }

    /// The sums of both terms over all rows, [columns] each.
    pub(crate) fn sums(&self, gpu: Gpu) -> [GpuArray; 2] {
        let sums = [(); 2].map(|()| GpuArray::new(gpu, self.columns));
        let (block_sums, blocks) = self.block_sums(gpu);
        let constants = TotalsBlock { blocks: blocks as u32, columns: self.columns as u32 };
        let arrays = [Binding::Read(&block_sums), Binding::Write(&sums[0]), Binding::Write(&sums[1])];
        TOTALS.launch(gpu, &[COLUMNS_OF_TOTALS], &constants, &arrays, self.columns.div_ceil(TOTALS_COLUMNS));
        sums
    }
}

/// Panics unless a kernel of terms is valid.
#[cfg(test)]
pub(crate) fn assert_valid_terms(kernel: &Kernel, specialisation: &[(&'static str, u32)]) {
    for columns in [1, 32] {
        super::layout_tests::assert_valid::<SumsBlock>(kernel, &[&[("COLUMNS", columns)], specialisation].concat());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::parts::tests::assert_equal_in_parts;
    use crate::gpu::tests::test_gpu;

    /// x and x².
    const SQUARES: Kernel = Kernel {
        name: "test of column sums",
        text: "#import gpu::column_sums
             @group(0) @binding(2) var<storage, read> x: array<f32>;
             fn terms(row: u32, column: u32) -> vec2<f32> {
                 let value = x[row * sums.columns + column];
                 return vec2<f32>(value, value * value);
             }",
    };

    #[test]
    fn the_kernels_are_valid() {
        assert_valid_terms(&SQUARES, &[]);
        super::super::layout_tests::assert_valid::<TotalsBlock>(&TOTALS, &[COLUMNS_OF_TOTALS]);
    }

    #[test]
    fn sums_of_whole_numbers_are_exact_for_any_size() {
        let Some(gpu) = test_gpu() else { return };
        for (rows, columns) in [(0, 3), (1, 1), (63, 33), (65, 8), (1000, 5), (20_000, 2), (300, 100)] {
            let values: Vec<f32> = (0..rows * columns).map(|at| (at * 7 % 11) as f32 - 4.0).collect();
            let mut expected = [vec![0.0; columns], vec![0.0; columns]];
            for (at, value) in values.iter().enumerate() {
                expected[0][at % columns] += value;
                expected[1][at % columns] += value * value;
            }
            let x = GpuArray::upload(gpu, &values);
            let arrays = [Binding::Read(&x)];
            let terms = Terms { kernel: &SQUARES, specialisation: &[], arrays: &arrays, rows, columns };
            let found = || {
                terms.sums(gpu).map(|sums| {
                    let mut out = vec![0.0_f32; columns];
                    sums.read_into(&mut out);
                    out
                })
            };
            assert_eq!(found(), expected, "{rows} rows of {columns}");
            assert_equal_in_parts(found);
        }
    }
}
