//! Matrix products on a GPU: by tiles, and sums of many terms in parts, in an order that depends on the sizes alone.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::sums::over_rows;

/// The text of a kernel of a product but for what loads its operands: `fn load_a(row: u32, term: u32, end: u32) -> f32` and
/// `fn load_b(term: u32, column: u32, end: u32) -> f32`, zero beyond the sizes and from `end` on.
pub const PRODUCT: &str = include_str!("product.wgsl");

/// Rows and columns of a workgroup's tile.
const TILE: usize = 64;
/// Terms per step of a workgroup; a part of a sum is a multiple of it.
const STEP: usize = 16;
/// Terms that are worth a part of their own.
const LEAST_TERMS: usize = 512;
/// Workgroups that occupy a large GPU.
const ENOUGH_GROUPS: usize = 512;

uniforms! {
    struct ProductBlock as "Product" {
        rows: u32,
        columns: u32,
        terms: u32,
        terms_per_part: u32,
        row_tiles: u32,
        column_tiles: u32,
        a_row: u32,
        a_term: u32,
        b_term: u32,
        b_column: u32,
    }
}

/// A·B [rows, columns], whose elements are sums of `terms` terms.
pub struct Product<'a> {
    /// Of [`PRODUCT`] and what loads the operands.
    pub kernel: &'a Kernel,
    pub specialisation: &'a [(&'static str, u32)],
    pub rows: usize,
    pub columns: usize,
    pub terms: usize,
    /// Elements between neighbouring rows and terms of A, and terms and columns of B, for what loads them.
    pub strides: [usize; 4],
    /// A, B, an output and a bias.
    pub arrays: [&'a GpuArray; 4],
    /// Whether there are so many terms that workgroups share their sum.
    pub in_parts: bool,
}

impl Product<'_> {
    /// The product, and the sums of the rows of A where the kernel makes them.
    pub fn launch(&self, gpu: Gpu) -> [GpuArray; 2] {
        let (row_tiles, column_tiles) = (self.rows.div_ceil(TILE), self.columns.div_ceil(TILE));
        let tiles = row_tiles * column_tiles;
        let most_parts = self.terms.div_ceil(LEAST_TERMS).max(1);
        let wanted = if self.in_parts { (ENOUGH_GROUPS / tiles.max(1)).clamp(1, most_parts) } else { 1 };
        let terms_per_part = self.terms.div_ceil(wanted).max(1).next_multiple_of(STEP);
        let parts = self.terms.div_ceil(terms_per_part).max(1);

        let results = [parts * self.rows * self.columns, parts * self.rows].map(|len| GpuArray::new(gpu, len));
        let read = self.arrays.map(Binding::Read);
        let arrays = [&read[..], &results.each_ref().map(Binding::Write)].concat();
        let block = self.block([terms_per_part, row_tiles, column_tiles]);
        self.kernel.launch(gpu, self.specialisation, &block, &arrays, parts * tiles);
        results.map(|array| if parts == 1 { array } else { over_rows(gpu, &array, array.len() / parts) })
    }

    fn block(&self, tiling: [usize; 3]) -> ProductBlock {
        let [terms_per_part, row_tiles, column_tiles] = tiling.map(|size| size as u32);
        let [rows, columns, terms] = [self.rows, self.columns, self.terms].map(|size| size as u32);
        let [a_row, a_term, b_term, b_column] = self.strides.map(|stride| stride as u32);
        ProductBlock { rows, columns, terms, terms_per_part, row_tiles, column_tiles, a_row, a_term, b_term, b_column }
    }
}

/// Panics unless a kernel of a product is valid.
#[cfg(test)]
pub fn assert_valid_product(kernel: &Kernel, specialisation: &[(&'static str, u32)]) {
    crate::gpu::layout::assert_valid::<ProductBlock>(kernel, specialisation);
}
