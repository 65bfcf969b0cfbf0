//! Soft histograms and their divergence from the uniform distribution: the regulariser of KineticGS (equation 9).
//!
//! A histogram with hard bins has no gradient. Here a value contributes to the two bins whose centres enclose it,
//! in proportion to its distance from them (a triangular kernel of one bin width), so that shares change smoothly as
//! values move. Values beyond the outermost centres belong entirely to the outermost bin and have no gradient: a share that
//! decreases outside would reward values for leaving the interval.

mod gpu;
#[cfg(test)]
mod tests;

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked, map_chunks};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Added to shares before the logarithm, so that an empty bin contributes 0 and not 0·∞.
const EMPTY_BIN: f64 = 1e-8;

/// Shares `[bins]` of the values x (any shape, not empty) in `bins` equal bins over [low, high]; they add up to 1.
pub fn soft_histogram<T: Real>(tape: &mut Tape<T>, x: Var, bins: usize, [low, high]: [f64; 2]) -> Var {
    assert!(bins >= 2 && low < high, "soft_histogram: {bins} bins over [{low}, {high}]");
    assert!(!tape.value(x).is_empty(), "soft_histogram: no values");
    tape.apply_one(SoftHistogram { bins, low, width: (high - low) / bins as f64 }, &[x])
}

/// Σ b·ln((b + 1e−8)·B), shape `[1]`: the Kullback–Leibler divergence of shares b `[B]` from the uniform distribution.
pub fn divergence_from_uniform<T: Real>(tape: &mut Tape<T>, shares: Var) -> Var {
    tape.apply_one(DivergenceFromUniform, &[shares])
}

struct SoftHistogram {
    bins: usize,
    low: f64,
    width: f64,
}

impl SoftHistogram {
    /// The lower of the two bins that share a value, the upper one's part in it, and whether that part changes with x.
    fn place<T: Real>(&self, x: T) -> (usize, T, bool) {
        // In bin widths from the first centre.
        let at = (x - T::from_f64(self.low)) / T::from_f64(self.width) - T::from_f64(0.5);
        let last = (self.bins - 1) as f64;
        let inside = at > T::ZERO && at < T::from_f64(last);
        let clamped = if at <= T::ZERO { T::ZERO } else { at.min(T::from_f64(last)) };
        let lower = clamped.to_f64().floor().min(last - 1.0);
        // Computed from x itself, so that NaN stays NaN.
        let upper_part = if inside || !at.is_finite() { at } else { clamped } - T::from_f64(lower);
        (lower as usize, upper_part, inside)
    }
}

impl<T: Real> Op<T> for SoftHistogram {
    fn name(&self) -> &'static str {
        "soft_histogram"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let x = inputs[0].as_slice();
        let partial = map_chunks(x.len(), CHUNK, |range| {
            let mut sums = vec![0.0; self.bins];
            for &x in &x[range] {
                let (lower, upper_part, _) = self.place(x);
                sums[lower] += 1.0 - upper_part.to_f64();
                sums[lower + 1] += upper_part.to_f64();
            }
            sums
        });
        let share = |bin: usize| partial.iter().map(|sums| sums[bin]).sum::<f64>() / x.len() as f64;
        vec![Tensor::from_vec([self.bins], (0..self.bins).map(|bin| T::from_f64(share(bin))).collect())]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let dy = pass.dy().as_slice();
        let x = inputs[0].as_slice();
        let factor = T::from_f64(1.0 / (self.width * x.len() as f64));
        let gradient = chunked(x.len(), CHUNK, |first, gradient| {
            for (gradient, &x) in gradient.iter_mut().zip(&x[first..]) {
                let (lower, _, inside) = self.place(x);
                *gradient = if inside { (dy[lower + 1] - dy[lower]) * factor } else { T::ZERO };
            }
        });
        vec![Some(Tensor::from_vec(inputs[0].shape(), gradient))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for SoftHistogram {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.shares_on_gpu(gpu, inputs[0])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.backward_on_gpu(gpu, pass.inputs[0], pass.dy()))]
    }
}

struct DivergenceFromUniform;

impl<T: Real> Op<T> for DivergenceFromUniform {
    fn name(&self) -> &'static str {
        "divergence_from_uniform"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let bins = inputs[0].len() as f64;
        let term = |share: f64| share * ((share + EMPTY_BIN) * bins).ln();
        vec![Tensor::scalar(T::from_f64(inputs[0].as_slice().iter().map(|share| term(share.to_f64())).sum()))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let dy = pass.dy();
        let (bins, dy) = (inputs[0].len() as f64, dy.as_slice()[0].to_f64());
        let slope = |share: f64| ((share + EMPTY_BIN) * bins).ln() + share / (share + EMPTY_BIN);
        let gradient = inputs[0].as_slice().iter().map(|share| T::from_f64(dy * slope(share.to_f64()))).collect();
        vec![Some(Tensor::from_vec(inputs[0].shape(), gradient))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for DivergenceFromUniform {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::divergence(gpu, inputs[0])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(gpu::divergence_backward(gpu, pass.inputs[0], pass.dy()))]
    }
}
