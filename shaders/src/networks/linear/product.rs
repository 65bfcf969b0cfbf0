//! Matrix products on a GPU: by tiles, and sums of many terms in parts, in an order that depends on the sizes alone. One
//! launch has several products.

use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};

/// The arrays of a kernel of products with one output each (`separate_outputs.wgsl`).
pub(crate) const EACH_ARRAYS: &[ItemArray] =
    &[ItemArray::read("a"), ItemArray::read("b"), ItemArray::read("side"), ItemArray::write("y")];
/// The arrays of a kernel of products that add up to one shared output (`summed_output.wgsl`).
pub(crate) const SUM_ARRAYS: &[ItemArray] = &[ItemArray::read("a"), ItemArray::read("b"), ItemArray::read("side")];

const PARTS: Grouped = Grouped {
    kernel: Kernel { name: "products, parts", text: include_str!("product_parts.wgsl") },
    shared: 0,
    arrays: &[ItemArray::read("parts"), ItemArray::write("product"), ItemArray::write("sums")],
};

/// Rows and columns of a workgroup's tile.
const TILE: usize = 64;
/// Terms per step of a workgroup; a part of a sum is a multiple of it.
const STEP: usize = 16;
/// Number of terms that justify a separate part.
const LEAST_TERMS: usize = 512;
/// Workgroups that occupy a large GPU.
const ENOUGH_GROUPS: usize = 512;

uniforms! {
    struct ProductItem as "Item" {
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
        y_row: u32,
        adds: u32,
        has_sums: u32,
    }
}

uniforms! {
    struct PartsItem as "Item" { rows: u32, columns: u32, parts: u32, adds: u32 }
}

/// A·B [rows, columns], whose elements are sums of `terms` terms.
pub(crate) struct Product<'a> {
    pub rows: usize,
    pub columns: usize,
    pub terms: usize,
    /// Strides in elements: rows and terms of A, terms and columns of B.
    pub strides: [usize; 4],
    /// A, B and a third operand: a bias, or a mask of the elements of A.
    pub arrays: [Binding<'a>; 3],
}

/// An output array, and whether the kernel accumulates into it.
pub(crate) type Output<'a> = (Binding<'a>, bool);

impl<'a> Product<'a> {
    fn tiles(&self) -> usize {
        self.rows.div_ceil(TILE) * self.columns.div_ceil(TILE)
    }

    fn constants(&self, terms_per_part: usize, y_row: usize, adds: bool) -> ProductItem {
        let [row_tiles, column_tiles] = [self.rows, self.columns].map(|size| size.div_ceil(TILE) as u32);
        let [rows, columns, terms] = [self.rows, self.columns, self.terms].map(|size| size as u32);
        let [a_row, a_term, b_term, b_column] = self.strides.map(|stride| stride as u32);
        let [terms_per_part, y_row] = [terms_per_part, y_row].map(|size| size as u32);
        let adds = u32::from(adds);
        ProductItem {
            rows,
            columns,
            terms,
            terms_per_part,
            row_tiles,
            column_tiles,
            a_row,
            a_term,
            b_term,
            b_column,
            y_row,
            adds,
            has_sums: 0,
        }
    }

    /// The item of the whole product.
    fn item(&self, adds: bool) -> Item<'a, ProductItem> {
        let constants = self.constants(self.terms.max(1), self.columns, adds);
        Item { constants, arrays: self.arrays.to_vec(), groups: self.tiles() }
    }

    /// Terms per part and number of parts, given the number of tiles of all products together.
    fn parts(&self, tiles: usize) -> [usize; 2] {
        let most = self.terms.div_ceil(LEAST_TERMS).max(1);
        let wanted = (ENOUGH_GROUPS / tiles.max(1)).clamp(1, most);
        let terms_per_part = self.terms.div_ceil(wanted).max(1).next_multiple_of(STEP);
        [terms_per_part, self.terms.div_ceil(terms_per_part).max(1)]
    }
}

/// A specialisation, which states whether items add up.
fn specialised(specialisation: &[(&'static str, u32)], together: bool) -> Vec<(&'static str, u32)> {
    [specialisation, &[("TOGETHER", u32::from(together))]].concat()
}

/// Computes every product into its output; `kernel` has the arrays [`EACH_ARRAYS`].
pub(crate) fn each(
    gpu: Gpu,
    kernel: &Grouped,
    specialisation: &[(&'static str, u32)],
    products: &[Product],
    outputs: &[Output],
) {
    kernel.launch(gpu, &specialised(specialisation, false), &[], &items_of(products, outputs));
}

/// The items of whole products.
fn items_of<'a>(products: &[Product<'a>], outputs: &[Output<'a>]) -> Vec<Item<'a, ProductItem>> {
    let item = |(product, &(y, adds)): (&Product<'a>, &Output<'a>)| {
        let mut item = product.item(adds);
        item.arrays.push(y);
        item
    };
    products.iter().zip(outputs).map(item).collect()
}

/// The sum of products that differ in their terms alone; `kernel` is of [`SUM`].
pub(crate) fn sum(
    gpu: Gpu,
    kernel: &Grouped,
    specialisation: &[(&'static str, u32)],
    products: &[Product],
    (y, adds): Output,
) {
    let mut items: Vec<Item<ProductItem>> = products.iter().map(|product| product.item(adds)).collect();
    let specialisation = specialised(specialisation, true);
    let capacity = kernel.capacity_for(gpu, &[y], &items);
    for (launch, items) in items.chunks_mut(capacity).enumerate() {
        items.iter_mut().for_each(|item| item.constants.adds |= u32::from(launch > 0));
        kernel.launch_together(gpu, &specialisation, &[y], items, products[0].tiles());
    }
}

/// Products, each with two outputs: of the product, and of the sums of the rows of its A.
pub(crate) type WithSums<'p, 'a> = (&'p [Product<'a>], &'p [[Output<'a>; 2]]);

/// Computes every product and the row sums of its A, with the terms split among workgroups.
/// `kernel` has the arrays [`EACH_ARRAYS`].
pub(crate) fn with_sums(gpu: Gpu, kernel: &Grouped, specialisation: &[(&'static str, u32)], products: WithSums) {
    each_with_sums(gpu, kernel, specialisation, (&[], &[]), products);
}

/// Computes products as [`each`] does and others as [`with_sums`] does, in the same launches.
pub(crate) fn each_with_sums(
    gpu: Gpu,
    kernel: &Grouped,
    specialisation: &[(&'static str, u32)],
    (alone, of_alone): (&[Product], &[Output]),
    (products, outputs): WithSums,
) {
    let tiles: usize = products.iter().map(Product::tiles).sum();
    let partial = |product: &Product| {
        let [_, parts] = product.parts(tiles);
        GpuArray::new(gpu, parts * product.rows * (product.columns + 1))
    };
    let partial: Vec<GpuArray> = products.iter().map(partial).collect();
    let mut items = items_of(alone, of_alone);
    let mut totals = Vec::new();
    for ((product, partial), [y, sums]) in products.iter().zip(&partial).zip(outputs) {
        let [terms_per_part, parts] = product.parts(tiles);
        let mut item = product.item(false);
        item.constants = ProductItem { has_sums: 1, ..product.constants(terms_per_part, product.columns + 1, false) };
        item.arrays.push(Binding::Write(partial));
        item.groups = parts * product.tiles();
        items.push(item);

        let [rows, columns, parts] = [product.rows, product.columns + 1, parts].map(|size| size as u32);
        let adds = u32::from(y.1) | u32::from(sums.1) << 1;
        let arrays = vec![Binding::Read(partial), y.0, sums.0];
        let groups = (product.rows * (product.columns + 1)).div_ceil(WORKGROUP_SIZE);
        totals.push(Item { constants: PartsItem { rows, columns, parts, adds }, arrays, groups });
    }
    kernel.launch(gpu, &specialised(specialisation, false), &[], &items);
    PARTS.launch(gpu, &[], &[], &totals);
}

/// Panics unless a kernel of products is valid.
#[cfg(test)]
pub(crate) fn assert_valid_product(kernel: &Grouped, specialisation: &[(&'static str, u32)]) {
    use crate::gpu::grouped::tests::assert_valid_grouped;
    assert_valid_grouped::<PartsItem>(&PARTS, &[]);
    for together in [false, true] {
        assert_valid_grouped::<ProductItem>(kernel, &specialised(specialisation, together));
    }
}
