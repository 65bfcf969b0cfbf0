//! Sums and means of all elements of a tensor.

mod gpu;
#[cfg(test)]
mod tests;

use crate::arrays::rows::{divide_rows, reshape};
use crate::gpu::Gpu;
use crate::pointwise;
use crate::tape::chunks::sum;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

pointwise! {
    /// w·x; 0 where w is 0, even if x is not finite.
    fn weighted_or_none(x, w) -> y {
        return select(w * x, 0.0, w == 0.0);
    }
    gradients(dy) {
        x: { return select(w * dy, 0.0, w == 0.0); }
        w: { return select(x * dy, 0.0, w == 0.0); }
    }
}

/// The mean of all elements, shape `[1]`; summed in f64 on the CPU, in f32 by tree reductions on a GPU.
pub fn mean<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    tape.apply_one(Total { is_mean: true }, &[x])
}

/// The sum of all elements, shape `[1]`; summed in f64 on the CPU, in f32 by tree reductions on a GPU.
pub fn total<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    tape.apply_one(Total { is_mean: false }, &[x])
}

/// Σ w·x / max(Σ w, 1), shape `[1]`, for x and weights w ≥ 0 of one shape: the mean of the selected elements if weights are 0 and
/// 1; 0 if none is selected. Elements of weight 0 may be non-finite; weights receive no gradient.
pub fn weighted_mean<T: Real>(tape: &mut Tape<T>, x: Var, weights: Var) -> Var {
    let weights = tape.detach(weights);
    let weighted = weighted_or_none(tape, x, weights);
    let [sum, count] = [weighted, weights].map(|terms| total(tape, terms));
    let mean = divide_rows(tape, sum, count, 1.0);
    reshape(tape, mean, [1])
}

struct Total {
    is_mean: bool,
}

impl Total {
    fn factor(&self, count: usize) -> f64 {
        if self.is_mean { 1.0 / count as f64 } else { 1.0 }
    }
}

impl<T: Real> Op<T> for Total {
    fn name(&self) -> &'static str {
        if self.is_mean { "mean" } else { "total" }
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let x = inputs[0].as_slice();
        vec![Tensor::scalar(T::from_f64(sum(x.len(), |index| x[index].to_f64()) * self.factor(x.len())))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let factor = T::from_f64(self.factor(inputs[0].len()));
        vec![Some(Tensor::full(inputs[0].shape(), pass.dy().as_slice()[0] * factor))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Total {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::total(gpu, inputs[0], self.factor(inputs[0].len()))])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let factor = self.factor(inputs[0].len());
        vec![Some(gpu::total_gradient(gpu, inputs[0], pass.dy(), factor))]
    }
}
