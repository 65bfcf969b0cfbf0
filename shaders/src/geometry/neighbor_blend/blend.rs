//! Weighted sums of values of the nodes of each point.

use super::{Neighbors, for_each_row, gpu};
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, exactly};

/// Σₖ wₙₖ·vₖ over the nodes k of point n, for weights [N, K] and values [M, C] → [N, C].
pub fn blend<T: Real>(tape: &mut Tape<T>, weights: Var, values: Var, neighbors: &Neighbors) -> Var {
    assert_eq!(tape.value(weights).shape(), [neighbors.points(), neighbors.per_point()], "blend: weights");
    assert_eq!(tape.value(values).rows(), neighbors.nodes(), "blend: one value per node");
    tape.apply_one(Blend { neighbors: neighbors.clone() }, &[weights, values])
}

struct Blend {
    neighbors: Neighbors,
}

impl<T: Real> Op<T> for Blend {
    fn name(&self) -> &'static str {
        "neighbor_blend"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [weights, values] = exactly(inputs);
        let columns = values.row_len();
        let mut out = vec![T::ZERO; weights.rows() * columns];
        for_each_row(&mut out, columns, |point, out| {
            for (&node, &weight) in self.neighbors.of_point(point).iter().zip(weights.row(point)) {
                out.iter_mut().zip(values.row(node as usize)).for_each(|(out, &value)| *out += weight * value);
            }
        });
        vec![Tensor::from_vec([weights.rows(), columns], out)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let ([weights, values], dy) = (exactly(inputs), pass.dy());
        let to_weights = || {
            let mut out = vec![T::ZERO; weights.len()];
            for_each_row(&mut out, weights.row_len(), |point, out| {
                for (out, &node) in out.iter_mut().zip(self.neighbors.of_point(point)) {
                    *out = values.row(node as usize).iter().zip(dy.row(point)).map(|(&value, &dy)| value * dy).sum();
                }
            });
            Tensor::from_vec(weights.shape(), out)
        };
        let to_values = || {
            let mut out = vec![T::ZERO; values.len()];
            for_each_row(&mut out, values.row_len(), |node, out| {
                for (point, rank) in self.neighbors.followers(node) {
                    let weight = weights.row(point)[rank];
                    out.iter_mut().zip(dy.row(point)).for_each(|(out, &dy)| *out += weight * dy);
                }
            });
            Tensor::from_vec(values.shape(), out)
        };
        vec![needs[0].then(to_weights), needs[1].then(to_values)]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Blend {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::blend(gpu, &self.neighbors, [inputs[0], inputs[1]])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        gpu::blend_backward(gpu, &self.neighbors, [inputs[0], inputs[1]], pass.dy(), needs)
    }
}
