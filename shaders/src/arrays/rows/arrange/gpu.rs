//! Elements moved on a GPU.

use std::ops::Range;

use crate::arrays::sums;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
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
        to_first: u32,
    }
}

fn copy(gpu: Gpu, from: &GpuArray, to: &GpuArray, columns: &ColumnsBlock) {
    let groups = Groups::Over(columns.rows as usize * columns.width as usize);
    COLUMNS.launch(gpu, &[], columns, &[Binding::Read(from), Binding::Write(to)], groups);
}

/// All of x [rows, C] to the columns from `first` on of y, which has `columns`.
fn put(gpu: Gpu, x: &GpuArray, [rows, width]: [usize; 2], y: &GpuArray, (first, columns): (usize, usize)) {
    let [rows, width, to_stride, to_first] = [rows, width, columns, first].map(|value| value as u32);
    let from = ColumnsBlock { rows, width, from_stride: width, from_columns: width, ..Default::default() };
    copy(gpu, x, y, &ColumnsBlock { to_stride, to_first, ..from });
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

/// Tensors of equally many rows side by side.
pub(super) fn concat_columns<T: Real>(gpu: Gpu, parts: &[&Tensor<T>]) -> Tensor<T> {
    let (rows, columns) = (parts[0].rows(), parts.iter().map(|part| part.row_len()).sum());
    let (y, mut first) = (GpuArray::new(gpu, rows * columns), 0);
    for part in parts {
        put(gpu, part.on_gpu(gpu), [rows, part.row_len()], &y, (first, columns));
        first += part.row_len();
    }
    Tensor::from_gpu([rows, columns], y)
}

/// Tensors below each other, in this shape.
pub(super) fn concat_rows<T: Real>(gpu: Gpu, parts: &[&Tensor<T>], shape: Vec<usize>) -> Tensor<T> {
    let len = shape.iter().product();
    let (y, mut first) = (GpuArray::new(gpu, len), 0);
    for part in parts {
        // The tensors below each other are concatenated like the columns of one row.
        put(gpu, part.on_gpu(gpu), [1, part.len()], &y, (first, len));
        first += part.len();
    }
    Tensor::from_gpu(shape, y)
}

/// The parts of x [rows, columns] in order, each in its shape, as they were put side by side; one row is the elements of
/// tensors below each other.
pub(super) fn split<'a, T: Real>(
    gpu: Gpu,
    x: &Tensor<T>,
    rows: usize,
    shapes: impl Iterator<Item = (&'a [usize], bool)>,
) -> Vec<Option<Tensor<T>>> {
    let (mut first, columns) = (0, x.len() / rows.max(1));
    let part = |(shape, needed): (&[usize], bool)| {
        let width = shape.iter().product::<usize>() / rows.max(1);
        let range = first as isize..(first + width) as isize;
        first += width;
        needed.then(|| Tensor::from_gpu(shape, cut(gpu, x.on_gpu(gpu), [rows, columns], range)))
    };
    shapes.map(part).collect()
}

/// The columns of a range of every row.
pub(super) fn columns<T: Real>(gpu: Gpu, x: &Tensor<T>, range: &Range<usize>) -> Tensor<T> {
    let of_x = range.start as isize..range.end as isize;
    Tensor::from_gpu([x.rows(), range.len()], cut(gpu, x.on_gpu(gpu), [x.rows(), x.row_len()], of_x))
}

/// x as the columns from `first` on of rows of this shape, which are 0 elsewhere.
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
fn the_kernel_is_valid() {
    crate::gpu::layout_tests::assert_valid::<ColumnsBlock>(&COLUMNS, &[]);
}
