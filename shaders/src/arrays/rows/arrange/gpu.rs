//! Elements moved on a GPU.

use std::ops::Range;

use crate::arrays::sums;
use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::{Real, Tensor};

const COLUMNS: Kernel = Kernel { name: "columns", text: include_str!("columns.wgsl") };

uniforms! {
    #[derive(Default)]
    struct ColumnsBlock as "Columns" {
        rows: u32,
        width: u32,
        from_stride: u32,
        from_columns: u32,
        from_first: u32,
        to_stride: u32,
    }
}

const JOIN: Grouped = Grouped {
    kernel: Kernel { name: "columns, joined", text: include_str!("join.wgsl") },
    shared: 1,
    arrays: &[ItemArray::read("part")],
};

const SPLIT: Grouped = Grouped {
    kernel: Kernel { name: "columns, split", text: include_str!("split.wgsl") },
    shared: 1,
    arrays: &[ItemArray::write("part")],
};

uniforms! {
    struct PartItem as "Item" {
        rows: u32,
        columns: u32,
        width: u32,
        joined_columns: u32,
        first: u32,
    }
}

/// A tensor whose leading columns are joined side by side with those of other tensors.
pub(super) struct Part {
    /// Columns of the tensor.
    pub columns: usize,
    /// The number of its leading columns that are joined.
    pub width: usize,
}

/// The constants of every part.
fn places(rows: usize, parts: &[Part]) -> Vec<PartItem> {
    let [rows, joined_columns] = [rows, parts.iter().map(|part| part.width).sum()].map(|value| value as u32);
    let place = |first: &mut u32, part: &Part| {
        let [columns, width] = [part.columns, part.width].map(|value| value as u32);
        let place = PartItem { rows, columns, width, joined_columns, first: *first };
        *first += width;
        Some(place)
    };
    parts.iter().scan(0, place).collect()
}

fn copy(gpu: Gpu, from: &GpuArray, to: &GpuArray, columns: &ColumnsBlock) {
    let groups = Groups::Over(columns.rows as usize * columns.width as usize);
    COLUMNS.launch(gpu, &[], columns, &[Binding::Read(from), Binding::Write(to)], groups);
}

/// The columns `range` of x [rows, columns]; columns outside x are zero.
fn cut(gpu: Gpu, x: &GpuArray, [rows, columns]: [usize; 2], range: Range<isize>) -> GpuArray {
    let width = range.len();
    let y = GpuArray::new(gpu, rows * width);
    let [rows, width, columns] = [rows, width, columns].map(|value| value as u32);
    let from = ColumnsBlock {
        from_stride: columns,
        from_columns: columns,
        from_first: range.start as u32,
        ..Default::default()
    };
    copy(gpu, x, &y, &ColumnsBlock { rows, width, to_stride: width, ..from });
    y
}

/// The leading columns of tensors of `rows` rows side by side, in this shape; one row is the elements of tensors below each
/// other.
pub(super) fn join<T: Real>(
    gpu: Gpu,
    tensors: &[&Tensor<T>],
    rows: usize,
    parts: &[Part],
    shape: Vec<usize>,
) -> Tensor<T> {
    let joined = GpuArray::new(gpu, shape.iter().product());
    let mut items = Vec::new();
    for (constants, tensor) in places(rows, parts).into_iter().zip(tensors) {
        let groups = (constants.rows as usize * constants.width as usize).div_ceil(WORKGROUP_SIZE);
        items.push(Item { constants, arrays: vec![Binding::Read(tensor.on_gpu(gpu))], groups });
    }
    JOIN.launch(gpu, &[], &[Binding::Write(&joined)], &items);
    Tensor::from_gpu(shape, joined)
}

/// The inverse of [`join`]: those parts of `joined` that are needed, each in its shape, with zeros in the remaining columns.
pub(super) fn split<T: Real>(
    gpu: Gpu,
    joined: &Tensor<T>,
    rows: usize,
    parts: &[Part],
    shapes_if_needed: &[Option<&[usize]>],
) -> Vec<Option<Tensor<T>>> {
    let array = |shape: &[usize]| GpuArray::new(gpu, shape.iter().product());
    let arrays: Vec<Option<GpuArray>> = shapes_if_needed.iter().map(|shape| shape.map(array)).collect();
    let mut items = Vec::new();
    for (constants, array) in places(rows, parts).into_iter().zip(&arrays) {
        if let Some(array) = array {
            let groups = array.len().div_ceil(WORKGROUP_SIZE);
            items.push(Item { constants, arrays: vec![Binding::Write(array)], groups });
        }
    }
    SPLIT.launch(gpu, &[], &[Binding::Read(joined.on_gpu(gpu))], &items);
    let tensor = |(array, shape): (Option<GpuArray>, &Option<&[usize]>)| Some(Tensor::from_gpu((*shape)?, array?));
    arrays.into_iter().zip(shapes_if_needed).map(tensor).collect()
}

/// The columns of a range of every row.
pub(super) fn columns<T: Real>(gpu: Gpu, x: &Tensor<T>, range: &Range<usize>) -> Tensor<T> {
    let of_x = range.start as isize..range.end as isize;
    Tensor::from_gpu([x.rows(), range.len()], cut(gpu, x.on_gpu(gpu), [x.rows(), x.row_len()], of_x))
}

/// Rows of this shape that contain x from column `first` on and are 0 elsewhere.
pub(crate) fn among_zeros<T: Real>(gpu: Gpu, x: &Tensor<T>, first: usize, shape: &[usize]) -> Tensor<T> {
    let columns = shape[1..].iter().product::<usize>() as isize;
    let range = -(first as isize)..columns - first as isize;
    Tensor::from_gpu(shape, cut(gpu, x.on_gpu(gpu), [x.rows(), x.row_len()], range))
}

/// One row repeated.
pub(super) fn repeat_row<T: Real>(gpu: Gpu, row: &Tensor<T>, rows: usize) -> Tensor<T> {
    let columns = row.len();
    let y = GpuArray::new(gpu, rows * columns);
    let width = columns as u32;
    let from = ColumnsBlock { rows: rows as u32, width, from_columns: width, ..Default::default() };
    copy(gpu, row.on_gpu(gpu), &y, &ColumnsBlock { to_stride: width, ..from });
    Tensor::from_gpu([rows, columns], y)
}

/// The sum of the rows of x, in this shape.
pub(crate) fn sum_rows<T: Real>(gpu: Gpu, x: &Tensor<T>, shape: &[usize]) -> Tensor<T> {
    Tensor::from_gpu(shape, sums::over_rows(gpu, x.on_gpu(gpu), x.row_len()))
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    crate::gpu::layout_tests::assert_valid::<ColumnsBlock>(&COLUMNS, &[]);
    for kernel in [JOIN, SPLIT] {
        crate::gpu::grouped::tests::assert_valid_grouped::<PartItem>(&kernel, &[]);
    }
}
