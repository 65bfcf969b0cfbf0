//! Elements moved on a GPU.

use std::ops::Range;

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, Part, in_windows, uniforms, windows};
use crate::sums;
use crate::tape::{Real, Tensor};

const COLUMNS: Kernel = Kernel { name: "columns", text: &[include_str!("columns.wgsl")] };

/// Elements per workgroup.
const GROUP: usize = 256;

uniforms! {
    #[derive(Default)]
    struct ColumnsBlock as "Columns" {
        rows: u32,
        width: u32,
        from_stride: u32,
        from_columns: u32,
        from_first: i32,
        to_stride: u32,
        to_first: u32,
    }
}

fn copy(gpu: Gpu, from: Binding, to: Binding, columns: &ColumnsBlock) {
    in_windows(gpu, columns.rows as usize, &[from, to], |rows, arrays| {
        let groups = (rows * columns.width as usize).div_ceil(GROUP);
        COLUMNS.launch(gpu, &[], &ColumnsBlock { rows: rows as u32, ..*columns }, arrays, groups);
    });
}

/// All of x [rows, C] to the columns from `first` on of y, which has `columns`.
fn put(gpu: Gpu, x: &GpuArray, [rows, width]: [usize; 2], y: &GpuArray, (first, columns): (usize, usize)) {
    let [rows, width, to_stride, to_first] = [rows, width, columns, first].map(|value| value as u32);
    let from = ColumnsBlock { rows, width, from_stride: width, from_columns: width, ..Default::default() };
    copy(gpu, Binding::Read(x), Binding::Write(y), &ColumnsBlock { to_stride, to_first, ..from });
}

/// The columns of a range of x [rows, columns], of which some may not be there.
fn cut(gpu: Gpu, x: &GpuArray, [rows, columns]: [usize; 2], range: Range<isize>) -> GpuArray {
    let width = range.len();
    let y = GpuArray::new(gpu, rows * width);
    let [rows, width, columns] = [rows, width, columns].map(|value| value as u32);
    let from = ColumnsBlock {
        from_stride: columns,
        from_columns: columns,
        from_first: range.start as i32,
        ..Default::default()
    };
    copy(gpu, Binding::Read(x), Binding::Write(&y), &ColumnsBlock { rows, width, to_stride: width, ..from });
    y
}

/// Elements of x from one place on to those of y from another on, as the columns of single rows: in parts of both.
fn copy_run(gpu: Gpu, (x, x_first): (&GpuArray, usize), (y, y_first): (&GpuArray, usize), len: usize) {
    let most = windows::fitting_elements(gpu);
    for start in (0..len).step_by(most) {
        let count = most.min(len - start);
        let (from, from_first) = Part::around(x, x_first + start, count);
        let (to, to_first) = Part::around(y, y_first + start, count);
        let columns = ColumnsBlock {
            rows: 1,
            width: count as u32,
            from_columns: (from_first + count) as u32,
            from_first: from_first as i32,
            to_first: to_first as u32,
            ..Default::default()
        };
        copy(gpu, Binding::ReadPart(from), Binding::WritePart(to), &columns);
    }
}

/// Tensors of equally many rows side by side.
pub fn concat_columns<T: Real>(gpu: Gpu, parts: &[&Tensor<T>]) -> Tensor<T> {
    let (rows, columns) = (parts[0].rows(), parts.iter().map(|part| part.row_len()).sum());
    let (y, mut first) = (GpuArray::new(gpu, rows * columns), 0);
    for part in parts {
        put(gpu, part.on_gpu(gpu), [rows, part.row_len()], &y, (first, columns));
        first += part.row_len();
    }
    Tensor::from_gpu([rows, columns], y)
}

/// Tensors below each other, in this shape.
pub fn concat_rows<T: Real>(gpu: Gpu, parts: &[&Tensor<T>], shape: Vec<usize>) -> Tensor<T> {
    let len = shape.iter().product();
    let (y, mut first) = (GpuArray::new(gpu, len), 0);
    for part in parts {
        copy_run(gpu, (part.on_gpu(gpu), 0), (&y, first), part.len());
        first += part.len();
    }
    Tensor::from_gpu(shape, y)
}

/// The parts of x [rows, columns] in order, each in its shape, as they were put side by side; one row is the elements of
/// tensors below each other.
pub fn split<'a, T: Real>(
    gpu: Gpu,
    x: &Tensor<T>,
    rows: usize,
    shapes: impl Iterator<Item = (&'a [usize], bool)>,
) -> Vec<Option<Tensor<T>>> {
    let (mut first, columns) = (0, x.len() / rows.max(1));
    let part = |(shape, needed): (&[usize], bool)| {
        let width = shape.iter().product::<usize>() / rows.max(1);
        let range = first..first + width;
        first += width;
        needed.then(|| Tensor::from_gpu(shape, part(gpu, x.on_gpu(gpu), [rows, columns], range)))
    };
    shapes.map(part).collect()
}

/// The columns of a range of x [rows, columns], of which there may be many if there is one row.
fn part(gpu: Gpu, x: &GpuArray, [rows, columns]: [usize; 2], range: Range<usize>) -> GpuArray {
    if rows != 1 {
        return cut(gpu, x, [rows, columns], range.start as isize..range.end as isize);
    }
    let y = GpuArray::new(gpu, range.len());
    copy_run(gpu, (x, range.start), (&y, 0), range.len());
    y
}

/// The columns of a range of every row.
pub fn columns<T: Real>(gpu: Gpu, x: &Tensor<T>, range: &Range<usize>) -> Tensor<T> {
    let of_x = range.start as isize..range.end as isize;
    Tensor::from_gpu([x.rows(), range.len()], cut(gpu, x.on_gpu(gpu), [x.rows(), x.row_len()], of_x))
}

/// x as the columns from `first` on of rows of this shape, which are 0 elsewhere.
pub fn among_zeros<T: Real>(gpu: Gpu, x: &Tensor<T>, first: usize, shape: &[usize]) -> Tensor<T> {
    let columns = shape[1..].iter().product::<usize>() as isize;
    let range = -(first as isize)..columns - first as isize;
    Tensor::from_gpu(shape, cut(gpu, x.on_gpu(gpu), [x.rows(), x.row_len()], range))
}

/// One row as often as asked for.
pub fn repeat_row<T: Real>(gpu: Gpu, row: &Tensor<T>, rows: usize) -> Tensor<T> {
    let columns = row.len();
    let y = GpuArray::new(gpu, rows * columns);
    let width = columns as u32;
    let from = ColumnsBlock { rows: rows as u32, width, from_columns: width, ..Default::default() };
    let row = Binding::Read(row.on_gpu(gpu)).all();
    copy(gpu, row, Binding::Write(&y), &ColumnsBlock { to_stride: width, ..from });
    Tensor::from_gpu([rows, columns], y)
}

/// The sum of the rows of x, in this shape.
pub fn sum_rows<T: Real>(gpu: Gpu, x: &Tensor<T>, shape: &[usize]) -> Tensor<T> {
    Tensor::from_gpu(shape, sums::over_rows(gpu, x.on_gpu(gpu), x.row_len()))
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::layout::assert_valid::<ColumnsBlock>(&COLUMNS, &[]);
}
