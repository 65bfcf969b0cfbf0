//! Fully connected layer: y = f(x·Wᵀ + b) with f the identity or ReLU.
//!
//! x [N, I], W [O, I], b `[O]` → y [N, O]. The ReLU has gradient 0 at 0. Rows are processed in chunks of fixed size, whose
//! contributions to the gradients of W and b are added in order.

mod cpu;
mod gpu;
#[cfg(test)]
mod gpu_tests;
mod layers;
pub(crate) mod matrix;
pub(crate) mod product;
mod reference;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::ops::Range;

use crate::gpu::Gpu;
use crate::tape::chunks::{chunked, chunked_with, map_chunks};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, exactly};
pub use layers::{Layer, linears};
use matrix::Matrix;

/// Rows per chunk: enough to amortise packing W once per chunk, few enough that x, y and dy of a layer of 64 to 256
/// channels stay in the second-level cache.
const ROWS_PER_CHUNK: usize = 512;

/// Rows without a gradient are skipped if they are at least one in this many.
const WORTH_COPYING: usize = 8;

/// The activation after the affine map.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Activation {
    /// No activation.
    Identity,
    /// max(0, x).
    Relu,
}

/// y = activation(x·Wᵀ + b) for x [N, I], weight [O, I], bias `[O]`.
pub fn linear<T: Real>(tape: &mut Tape<T>, x: Var, weight: Var, bias: Var, activation: Activation) -> Var {
    let layer = Linear::new(tape, x, weight, bias, activation);
    tape.apply_one(layer, &[x, weight, bias])
}

/// The inputs of the operation.
const OWN: gpu::Places = gpu::Places { x: 0, weight: 1, bias: 2 };

struct Linear {
    inputs: usize,
    outputs: usize,
    activation: Activation,
}

/// Sums over the rows of one chunk.
struct WeightGradients<T> {
    weight: Vec<T>,
    bias: Vec<T>,
}

impl<T: Real> Op<T> for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [x, weight, bias] = exactly(inputs);
        let y = chunked(x.rows() * self.outputs, ROWS_PER_CHUNK * self.outputs, |first, y| {
            let rows = first / self.outputs..(first + y.len()) / self.outputs;
            let x = &x.as_slice()[rows.start * self.inputs..rows.end * self.inputs];
            multiply(Matrix::new(x, self.inputs), Matrix::new(weight.as_slice(), self.inputs).transposed(), y);
            self.add_bias_and_activate(bias.as_slice(), y);
        });
        vec![Tensor::from_vec([x.rows(), self.outputs], y)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, needs, .. } = pass;
        let ([x, weight, bias], dy) = (exactly(inputs), pass.dy());
        let of_chunk = |rows: Range<usize>, dx: Option<&mut [T]>| {
            let of_rows = |tensor: &'_ Tensor<T>| rows.start * tensor.row_len()..rows.end * tensor.row_len();
            let dz = self.through_activation(&outputs[0].as_slice()[of_rows(dy)], &dy.as_slice()[of_rows(dy)]);
            self.backward_live_rows(&dz, &x.as_slice()[of_rows(x)], weight.as_slice(), dx, needs)
        };
        let (dx, chunks) = if needs[0] {
            let (dx, chunks) = chunked_with(x.len(), ROWS_PER_CHUNK * self.inputs, |first, dx| {
                of_chunk(first / self.inputs..(first + dx.len()) / self.inputs, Some(dx))
            });
            (Some(dx), chunks)
        } else {
            (None, map_chunks(x.rows(), ROWS_PER_CHUNK, |rows| of_chunk(rows, None)))
        };
        let total = |part: fn(&WeightGradients<T>) -> &[T], like: &Tensor<T>| {
            let mut total = vec![T::ZERO; like.len()];
            chunks.iter().for_each(|chunk| add(&mut total, part(chunk)));
            Tensor::from_vec(like.shape(), total)
        };
        vec![
            dx.map(|dx| Tensor::from_vec(x.shape(), dx)),
            needs[1].then(|| total(|chunk| &chunk.weight, weight)),
            needs[2].then(|| total(|chunk| &chunk.bias, bias)),
        ]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Linear {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(gpu::forward(gpu, &[OWN], self.activation, inputs))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate_gpu(gpu, pass, totals))
    }

    fn accumulate_gpu(&mut self, gpu: Gpu, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        gpu::LayersBackward { gpu, layers: &[OWN], activation: self.activation, pass }.add_gradients(totals);
    }
}

impl Linear {
    fn new<T: Real>(tape: &Tape<T>, x: Var, weight: Var, bias: Var, activation: Activation) -> Self {
        let (inputs, outputs) = (tape.value(weight).row_len(), tape.value(weight).rows());
        assert_eq!(tape.value(x).row_len(), inputs, "linear: x has the wrong number of columns");
        assert_eq!(tape.value(bias).len(), outputs, "linear: bias has the wrong length");
        Self { inputs, outputs, activation }
    }

    fn add_bias_and_activate<T: Real>(&self, bias: &[T], y: &mut [T]) {
        for row in y.chunks_exact_mut(self.outputs) {
            match self.activation {
                Activation::Identity => row.iter_mut().zip(bias).for_each(|(y, &bias)| *y += bias),
                // Written so that a NaN stays a NaN.
                Activation::Relu => row.iter_mut().zip(bias).for_each(|(y, &bias)| {
                    let sum = *y + bias;
                    *y = if sum < T::ZERO { T::ZERO } else { sum };
                }),
            }
        }
    }

    /// The gradient before the activation.
    fn through_activation<'a, T: Real>(&self, y: &[T], dy: &'a [T]) -> Cow<'a, [T]> {
        match self.activation {
            Activation::Identity => Cow::Borrowed(dy),
            Activation::Relu => y.iter().zip(dy).map(|(&y, &dy)| if y <= T::ZERO { T::ZERO } else { dy }).collect(),
        }
    }

    /// The backward pass over the nonzero rows of `dz` only: a Gaussian that contributes to no pixel has no gradient. `dx` must
    /// be zero.
    fn backward_live_rows<T: Real>(
        &self,
        dz: &[T],
        x: &[T],
        weight: &[T],
        dx: Option<&mut [T]>,
        needs: &[bool],
    ) -> WeightGradients<T> {
        let is_live = |row: &[T]| row.iter().fold(false, |live, &value| live | (value != T::ZERO));
        let rows = dz.chunks_exact(self.outputs).enumerate();
        let live: Vec<usize> = rows.filter(|(_, row)| is_live(row)).map(|(index, _)| index).collect();
        // Copying pays off only if enough rows are left out.
        if live.len() * self.outputs > dz.len() - dz.len() / WORTH_COPYING {
            return self.backward_rows(dz, x, weight, dx, needs);
        }
        let compact = |data: &[T], row_len: usize| -> Vec<T> {
            let mut rows = Vec::with_capacity(live.len() * row_len);
            live.iter().for_each(|&row| rows.extend_from_slice(&data[row * row_len..(row + 1) * row_len]));
            rows
        };
        let mut live_dx = dx.is_some().then(|| vec![T::ZERO; live.len() * self.inputs]);
        let (live_dz, live_x) = (compact(dz, self.outputs), compact(x, self.inputs));
        let sums = self.backward_rows(&live_dz, &live_x, weight, live_dx.as_deref_mut(), needs);
        if let (Some(dx), Some(live_dx)) = (dx, live_dx) {
            for (row, live_dx) in live.iter().zip(live_dx.chunks_exact(self.inputs)) {
                dx[row * self.inputs..(row + 1) * self.inputs].copy_from_slice(live_dx);
            }
        }
        sums
    }

    /// dx = dz·W, dW = dzᵀ·x, db = Σ dz for one chunk of rows.
    fn backward_rows<T: Real>(
        &self,
        dz: &[T],
        x: &[T],
        weight: &[T],
        dx: Option<&mut [T]>,
        needs: &[bool],
    ) -> WeightGradients<T> {
        if let Some(dx) = dx {
            multiply(Matrix::new(dz, self.outputs), Matrix::new(weight, self.inputs), dx);
        }
        let mut sums = WeightGradients { weight: Vec::new(), bias: Vec::new() };
        if needs[1] {
            sums.weight = vec![T::ZERO; self.outputs * self.inputs];
            multiply(Matrix::new(dz, self.outputs).transposed(), Matrix::new(x, self.inputs), &mut sums.weight);
        }
        if needs[2] {
            sums.bias = vec![T::ZERO; self.outputs];
            dz.chunks_exact(self.outputs).for_each(|row| add(&mut sums.bias, row));
        }
        sums
    }
}

fn add<T: Real>(total: &mut [T], term: &[T]) {
    total.iter_mut().zip(term).for_each(|(total, &term)| *total += term);
}

/// out = lhs·rhs, row-major, on one thread.
pub(crate) fn multiply<T: Real>(lhs: Matrix<T>, rhs: Matrix<T>, out: &mut [T]) {
    match (lhs.as_f32(), rhs.as_f32(), T::as_f32_mut(out)) {
        (Some(lhs), Some(rhs), Some(out)) => cpu::multiply(lhs, rhs, out),
        _ => reference::multiply(lhs, rhs, out),
    }
}
