mod gpu;

use std::array::from_fn;
use std::ops::Range;

use crate::gpu::Gpu;
use crate::tape::chunks::{chunked, map_parts};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, exactly};
use gpu::RowKernel;
pub(crate) use gpu::RowWgsl;
#[cfg(test)]
pub(crate) use gpu::validate_map;

/// Rows per parallel chunk: rows are short, so this is tens of microseconds.
const ROWS_PER_CHUNK: usize = 1024;

/// A function of one row of each of `I` tensors, applied to every row.
pub(crate) trait RowMap<const I: usize>: Sized + Send + Sync + 'static {
    /// The name in profiles and messages.
    const NAME: &'static str;

    /// The number of output columns for these numbers of input columns; panics where they do not fit together.
    fn output_columns(&self, input_columns: [usize; I]) -> usize;

    /// Writes the output row.
    fn value<T: Real>(&self, inputs: [&[T]; I], y: &mut [T]);

    /// Writes the gradient of every input row, which holds zeros on entry.
    fn gradient<T: Real>(&self, inputs: [&[T]; I], y: &[T], dy: &[T], gradients: [&mut [T]; I]);

    /// The map in WGSL; `None` if it has no text for these numbers of input columns.
    fn wgsl(&self, _input_columns: [usize; I]) -> Option<RowWgsl> {
        None
    }

    /// [`RowMap::value`] for all rows, with kernels for a GPU; `None` if there are none for these inputs: the map then runs on
    /// the CPU in both directions.
    fn value_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; I]) -> Option<Tensor<T>> {
        Some(RowKernel::new(self, inputs.map(Tensor::row_len))?.value(gpu, inputs))
    }

    /// [`RowMap::gradient`] for all rows, with kernels for a GPU; called only if [`RowMap::value_gpu`] computed the output.
    fn gradient_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: [&Tensor<T>; I],
        y: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; I] {
        let kernel = RowKernel::new(self, inputs.map(Tensor::row_len)).expect("a kernel computed the output");
        kernel.gradients(gpu, inputs, y, dy)
    }
}

/// Applies `map` to the rows of I tensors of N rows each → [N, output columns].
pub(crate) fn map_rows<T: Real, M: RowMap<I>, const I: usize>(tape: &mut Tape<T>, map: M, inputs: [Var; I]) -> Var {
    let rows = inputs.map(|input| tape.value(input).rows());
    assert!(rows.iter().all(|&count| count == rows[0]), "{}: numbers of rows differ: {rows:?}", M::NAME);
    tape.apply_one(MapRows::<M, I> { map }, &inputs)
}

struct MapRows<M, const I: usize> {
    map: M,
}

impl<T: Real, M: RowMap<I>, const I: usize> Op<T> for MapRows<M, I> {
    fn name(&self) -> &'static str {
        M::NAME
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let rows = inputs[0].rows();
        let columns = self.map.output_columns(from_fn(|input| inputs[input].row_len()));
        let y = chunked(rows * columns, ROWS_PER_CHUNK * columns, |first, y| {
            for (row, y) in y.chunks_exact_mut(columns).enumerate() {
                self.map.value(from_fn(|input| inputs[input].row(first / columns + row)), y);
            }
        });
        vec![Tensor::from_vec([rows, columns], y)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, .. } = pass;
        let dy = pass.dy();
        let columns: [usize; I] = from_fn(|input| inputs[input].row_len());
        let mut gradients: [Vec<T>; I] = from_fn(|input| vec![T::ZERO; inputs[input].len()]);
        let mut parts = gradients.each_mut().map(|gradient| gradient.as_mut_slice());
        let mut chunks = Vec::new();
        for first in (0..dy.rows()).step_by(ROWS_PER_CHUNK) {
            let rows = ROWS_PER_CHUNK.min(dy.rows() - first);
            let chunk: [&mut [T]; I] =
                from_fn(|input| parts[input].split_off_mut(..rows * columns[input]).expect("as many rows"));
            chunks.push((first..first + rows, chunk));
        }
        map_parts(chunks, |_, (rows, mut chunk): (Range<usize>, [&mut [T]; I])| {
            for row in rows {
                let gradients = from_fn(|input| chunk[input].split_off_mut(..columns[input]).expect("as many rows"));
                let row_of = |input: usize| inputs[input].row(row);
                self.map.gradient(from_fn(row_of), outputs[0].row(row), dy.row(row), gradients);
            }
        });
        inputs.iter().zip(gradients).map(|(input, values)| Some(Tensor::from_vec(input.shape(), values))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real, M: RowMap<I>, const I: usize> GpuOp<T> for MapRows<M, I> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.map.value_gpu(gpu, exactly(inputs))?])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, .. } = pass;
        let gradients = self.map.gradient_gpu(gpu, exactly(inputs), outputs[0], pass.dy());
        gradients.map(Some).into()
    }
}
