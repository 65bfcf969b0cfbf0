//! Weighted sums of values of the nodes of each point.

use super::{Neighbors, for_each_row, gpu};
use crate::gpu::Gpu;
use crate::tape::{Op, Real, Tape, Tensor, Var};

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
        let &[weights, values] = inputs else { unreachable!("two inputs") };
        let columns = values.row_len();
        let mut out = vec![T::ZERO; weights.rows() * columns];
        for_each_row(&mut out, columns, |point, out| {
            for (&node, &weight) in self.neighbors.of_point(point).iter().zip(weights.row(point)) {
                out.iter_mut().zip(values.row(node as usize)).for_each(|(out, &value)| *out += weight * value);
            }
        });
        vec![Tensor::from_vec([weights.rows(), columns], out)]
    }

    fn backward(
        &mut self,
        inputs: &[&Tensor<T>],
        _outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let (&[weights, values], Some(dy)) = (inputs, output_grads[0]) else { return vec![None; 2] };
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

    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::blend(gpu, &self.neighbors, [inputs[0], inputs[1]])])
    }

    fn backward_gpu(
        &mut self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        _outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        needs: &[bool],
    ) -> Option<Vec<Option<Tensor<T>>>> {
        Some(gpu::blend_backward(gpu, &self.neighbors, [inputs[0], inputs[1]], output_grads[0]?, needs))
    }
}
