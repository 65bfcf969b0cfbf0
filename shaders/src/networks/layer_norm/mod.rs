//! Layer normalisation (Ba et al. 2016): standardises rows to mean 0 and variance 1, then scales and shifts columns.

mod gpu;
#[cfg(test)]
mod tests;

use crate::arrays::rows::{RowMap, map_rows};
use crate::gpu::Gpu;
use crate::tape::chunks::map_chunks;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, exactly};

/// Added to the variance, the customary value: a row of equal values becomes zeros.
const EPSILON: f64 = 1e-5;

/// Rows per partial sum of the backward pass.
const ROWS_PER_CHUNK: usize = 1024;

/// (x − mean) / √(variance + 10⁻⁵)·scale + offset for x [N, C], scale and offset `[C]`; mean and variance of each row.
pub fn layer_norm<T: Real>(tape: &mut Tape<T>, x: Var, scale: Var, offset: Var) -> Var {
    let standard = map_rows(tape, Standardize, [x]);
    affine_columns(tape, standard, scale, offset)
}

/// x·scale + offset by column: x [N, C], scale and offset [C].
pub(crate) fn affine_columns<T: Real>(tape: &mut Tape<T>, x: Var, scale: Var, offset: Var) -> Var {
    let columns = tape.value(x).row_len();
    assert!([scale, offset].iter().all(|&var| tape.value(var).shape() == [columns]), "affine_columns: one per column");
    tape.apply_one(AffineColumns, &[x, scale, offset])
}

fn mean<T: Real>(row: &[T]) -> T {
    row.iter().copied().sum::<T>() / T::from_f64(row.len() as f64)
}

struct Standardize;

impl Standardize {
    /// Mean and standard deviation.
    fn moments<T: Real>(x: &[T]) -> (T, T) {
        let center = mean(x);
        let variance = x.iter().map(|&x| (x - center) * (x - center)).sum::<T>() / T::from_f64(x.len() as f64);
        (center, (variance + T::from_f64(EPSILON)).sqrt())
    }
}

impl RowMap<1> for Standardize {
    const NAME: &'static str = "standardize";

    fn output_columns(&self, [columns]: [usize; 1]) -> usize {
        columns
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        let (center, deviation) = Self::moments(x);
        y.iter_mut().zip(x).for_each(|(y, &x)| *y = (x - center) / deviation);
    }

    fn gradient<T: Real>(&self, [x]: [&[T]; 1], y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        let (_, deviation) = Self::moments(x);
        let by_mean = mean(dy);
        let by_deviation = y.iter().zip(dy).map(|(&y, &dy)| y * dy).sum::<T>() / T::from_f64(y.len() as f64);
        for (dx, (&y, &dy)) in dx.iter_mut().zip(y.iter().zip(dy)) {
            *dx = (dy - by_mean - y * by_deviation) / deviation;
        }
    }

    fn value_gpu<T: Real>(&self, gpu: Gpu, [x]: [&Tensor<T>; 1]) -> Option<Tensor<T>> {
        Some(gpu::standardize(gpu, x))
    }

    fn gradient_gpu<T: Real>(&self, gpu: Gpu, [x]: [&Tensor<T>; 1], y: &Tensor<T>, dy: &Tensor<T>) -> [Tensor<T>; 1] {
        [gpu::standardize_backward(gpu, [x, y, dy])]
    }
}

struct AffineColumns;

impl<T: Real> Op<T> for AffineColumns {
    fn name(&self) -> &'static str {
        "affine_columns"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [x, scale, offset] = exactly(inputs);
        let mut y = x.clone();
        for row in y.make_mut().chunks_exact_mut(x.row_len()) {
            let by_column = scale.as_slice().iter().zip(offset.as_slice());
            row.iter_mut().zip(by_column).for_each(|(y, (&scale, &offset))| *y = *y * scale + offset);
        }
        vec![y]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let ([x, scale, _], dy) = (exactly(pass.inputs), pass.dy());
        let columns = x.row_len();
        let mut dx = dy.clone();
        for row in dx.make_mut().chunks_exact_mut(columns) {
            row.iter_mut().zip(scale.as_slice()).for_each(|(dx, &scale)| *dx *= scale);
        }
        let sums = map_chunks(x.rows(), ROWS_PER_CHUNK, |rows| {
            let mut sums = [vec![T::ZERO; columns], vec![T::ZERO; columns]];
            for (column, (x, dy)) in rows.flat_map(|row| x.row(row).iter().zip(dy.row(row)).enumerate()) {
                sums[0][column] += *x * *dy;
                sums[1][column] += *dy;
            }
            sums
        });
        let total = |part: usize| {
            let mut total = vec![T::ZERO; columns];
            sums.iter().for_each(|chunk| total.iter_mut().zip(&chunk[part]).for_each(|(total, &sum)| *total += sum));
            Some(Tensor::from_vec([columns], total))
        };
        vec![Some(dx), total(0), total(1)]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for AffineColumns {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::affine_columns(gpu, [inputs[0], inputs[1], inputs[2]])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        gpu::affine_columns_backward(gpu, [inputs[0], inputs[1], inputs[2]], pass.dy())
    }
}
