//! Operations that move elements and compute nothing.

mod gpu;

use std::ops::Range;

use super::with_rows;
use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked, map_chunks};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Rows per partial sum of the backward pass of [`repeat_row`].
const ROWS_PER_CHUNK: usize = 4096;

/// Tensors of N rows side by side: [N, a], [N, b], … → [N, a + b + …].
pub fn concat_columns<T: Real>(tape: &mut Tape<T>, parts: &[Var]) -> Var {
    let all: Vec<(Var, usize)> = parts.iter().map(|&part| (part, tape.value(part).row_len())).collect();
    concat_leading_columns(tape, &all)
}

/// The leading columns of tensors of N rows side by side: of each `(x, count)`, the first `count` columns of x [N, C].
pub fn concat_leading_columns<T: Real>(tape: &mut Tape<T>, parts: &[(Var, usize)]) -> Var {
    let rows = tape.value(parts[0].0).rows();
    for &(part, width) in parts {
        let value = tape.value(part);
        assert_eq!(value.rows(), rows, "concat_columns: numbers of rows differ");
        assert!(width <= value.row_len(), "concat_columns: {width} of {} columns", value.row_len());
    }
    let (parts, widths): (Vec<Var>, _) = parts.iter().copied().unzip();
    tape.apply_one(ConcatColumns { widths }, &parts)
}

/// Tensors of equal row shape below each other: [M, …], [N, …], … → [M + N + …, …].
pub fn concat_rows<T: Real>(tape: &mut Tape<T>, parts: &[Var]) -> Var {
    let row_shape = |part: &Var| tape.value(*part).shape()[1..].to_vec();
    let first = row_shape(&parts[0]);
    assert!(parts.iter().all(|part| row_shape(part) == first), "concat_rows: shapes of rows differ");
    tape.apply_one(ConcatRows, parts)
}

/// Some columns of every row: [N, C] → [N, range.len()].
pub fn columns<T: Real>(tape: &mut Tape<T>, x: Var, range: Range<usize>) -> Var {
    let count = tape.value(x).row_len();
    assert!(range.start <= range.end && range.end <= count, "columns: {range:?} of {count}");
    tape.apply_one(Columns { range }, &[x])
}

/// One row repeated `rows` times: `[C]` or [1, C] → [rows, C].
pub fn repeat_row<T: Real>(tape: &mut Tape<T>, row: Var, rows: usize) -> Var {
    let shape = tape.value(row).shape();
    assert!(shape.len() == 1 || shape[0] == 1, "repeat_row: {shape:?} is more than one row");
    tape.apply_one(RepeatRow { rows }, &[row])
}

/// Reshapes x without reordering its elements.
pub fn reshape<T: Real>(tape: &mut Tape<T>, x: Var, shape: impl Into<Vec<usize>>) -> Var {
    tape.apply_one(Reshape { shape: shape.into() }, &[x])
}

struct ConcatColumns {
    /// The number of leading columns of each input.
    widths: Vec<usize>,
}

impl ConcatColumns {
    fn parts<T: Real>(&self, inputs: &[&Tensor<T>]) -> Vec<gpu::Part> {
        let part = |(input, &width): (&&Tensor<T>, &usize)| gpu::Part { columns: input.row_len(), width };
        inputs.iter().zip(&self.widths).map(part).collect()
    }
}

impl<T: Real> Op<T> for ConcatColumns {
    fn name(&self) -> &'static str {
        "concat_columns"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (rows, columns) = (inputs[0].rows(), self.widths.iter().sum());
        let joined = chunked_rows(rows, columns, |row, joined| {
            let mut rest = joined;
            for (input, &width) in inputs.iter().zip(&self.widths) {
                let part = rest.split_off_mut(..width).expect("as many columns");
                part.copy_from_slice(&input.row(row)[..width]);
            }
        });
        vec![Tensor::from_vec([rows, columns], joined)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        let mut first = 0;
        let mut part_of = |((input, &width), &needed): ((&&Tensor<T>, &usize), &bool)| {
            let range = first..first + width;
            first = range.end;
            let copy_row = |row, dx: &mut [T]| dx[..width].copy_from_slice(&dy.row(row)[range.clone()]);
            needed.then(|| Tensor::from_vec(input.shape(), chunked_rows(input.rows(), input.row_len(), copy_row)))
        };
        inputs.iter().zip(&self.widths).zip(needs).map(&mut part_of).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for ConcatColumns {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        let (rows, columns) = (inputs[0].rows(), self.widths.iter().sum());
        Some(vec![gpu::join(gpu, inputs, rows, &self.parts(inputs), vec![rows, columns])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let dy = pass.dy();
        gpu::split(gpu, dy, dy.rows(), &self.parts(pass.inputs), &needed_shapes(&pass))
    }
}

/// The shapes of those inputs that need a gradient.
fn needed_shapes<'a, T: Real>(pass: &Backward<'a, T>) -> Vec<Option<&'a [usize]>> {
    pass.inputs.iter().zip(pass.needs).map(|(input, &needed)| needed.then(|| input.shape())).collect()
}

struct ConcatRows;

/// The shape of tensors below each other.
fn joined_shape<T: Real>(parts: &[&Tensor<T>]) -> Vec<usize> {
    with_rows(parts[0].shape(), parts.iter().map(|part| part.rows()).sum())
}

impl<T: Real> Op<T> for ConcatRows {
    fn name(&self) -> &'static str {
        "concat_rows"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let slices: Vec<&[T]> = inputs.iter().map(|input| input.as_slice()).collect();
        vec![Tensor::from_vec(joined_shape(inputs), slices.concat())]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        let mut rest = dy.as_slice();
        let mut part_of = |(input, &needed): (&&Tensor<T>, &bool)| {
            let part = rest.split_off(..input.len()).expect("as many rows");
            needed.then(|| Tensor::from_vec(input.shape(), part.to_vec()))
        };
        inputs.iter().zip(needs).map(&mut part_of).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl ConcatRows {
    /// Tensors below each other are side by side as parts of one row.
    fn parts<T: Real>(inputs: &[&Tensor<T>]) -> Vec<gpu::Part> {
        inputs.iter().map(|input| gpu::Part { columns: input.len(), width: input.len() }).collect()
    }
}

impl<T: Real> GpuOp<T> for ConcatRows {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::join(gpu, inputs, 1, &Self::parts(inputs), joined_shape(inputs))])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        gpu::split(gpu, pass.dy(), 1, &Self::parts(pass.inputs), &needed_shapes(&pass))
    }
}

struct Columns {
    range: Range<usize>,
}

impl<T: Real> Op<T> for Columns {
    fn name(&self) -> &'static str {
        "columns"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        vec![Tensor::from_vec([inputs[0].rows(), self.range.len()], cut_columns(inputs[0], self.range.clone()))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let dy = pass.dy();
        let put_row = |row, dx: &mut [T]| dx[self.range.clone()].copy_from_slice(dy.row(row));
        let dx = chunked_rows(inputs[0].rows(), inputs[0].row_len(), put_row);
        vec![Some(Tensor::from_vec(inputs[0].shape(), dx))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Columns {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::columns(gpu, inputs[0], &self.range)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(gpu::among_zeros(gpu, pass.dy(), self.range.start, pass.inputs[0].shape()))]
    }
}

fn cut_columns<T: Real>(x: &Tensor<T>, range: Range<usize>) -> Vec<T> {
    chunked_rows(x.rows(), range.len(), |row, cut| cut.copy_from_slice(&x.row(row)[range.clone()]))
}

/// [rows, row_len], of which `body(index, row)` sets every row, in parallel where there are many; rows are 0 before.
fn chunked_rows<T: Real>(rows: usize, row_len: usize, body: impl Fn(usize, &mut [T]) + Sync) -> Vec<T> {
    let rows_per_chunk = (CHUNK / row_len.max(1)).max(1);
    chunked(rows * row_len, rows_per_chunk * row_len, |first, rows| {
        for (row, values) in rows.chunks_exact_mut(row_len).enumerate() {
            body(first / row_len + row, values);
        }
    })
}

struct RepeatRow {
    rows: usize,
}

impl<T: Real> Op<T> for RepeatRow {
    fn name(&self) -> &'static str {
        "repeat_row"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let row = inputs[0].as_slice();
        vec![Tensor::from_vec([self.rows, row.len()], row.repeat(self.rows))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let dy = pass.dy();
        let partial_sum = |rows: Range<usize>| {
            let mut sum = vec![0.0; dy.row_len()];
            rows.for_each(|row| sum.iter_mut().zip(dy.row(row)).for_each(|(sum, value)| *sum += value.to_f64()));
            sum
        };
        let mut total = vec![0.0; dy.row_len()];
        for part in map_chunks(dy.rows(), ROWS_PER_CHUNK, partial_sum) {
            total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
        }
        vec![Some(Tensor::from_vec(pass.inputs[0].shape(), total.into_iter().map(T::from_f64).collect()))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for RepeatRow {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::repeat_row(gpu, inputs[0], self.rows)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(gpu::sum_rows(gpu, pass.dy(), pass.inputs[0].shape()))]
    }
}

struct Reshape {
    shape: Vec<usize>,
}

impl<T: Real> Op<T> for Reshape {
    fn name(&self) -> &'static str {
        "reshape"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        vec![inputs[0].clone().reshape(self.shape.clone())]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(pass.dy().clone().reshape(pass.inputs[0].shape()))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Reshape {
    // Elements stay where they are.
    fn forward_gpu(&mut self, _gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(self.forward(inputs))
    }

    fn backward_gpu(&mut self, _gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        self.backward(pass)
    }
}
