//! The weights with which a point follows its nodes.

use super::{Neighbors, for_each_row, gpu};
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Added to every weight before they are divided by their sum, so that a point far from all nodes follows them equally
/// (published code).
const FLOOR: f64 = 1e-7;

/// wₙₖ ∝ e^(−‖xₙ − pₖ‖² / 2rₖ²)·σ(gₖ) + 10⁻⁷, of sum 1 over the K nodes of a point: [N, K].
///
/// Points x [N, D], nodes p [M, D], logarithms of radii r [M, 1], and gate logits g [M, 1]; without gates
/// σ(g) is 1.
pub fn weights<T: Real>(
    tape: &mut Tape<T>,
    points: Var,
    nodes: Var,
    log_radii: Var,
    gates: Option<Var>,
    neighbors: &Neighbors,
) -> Var {
    let rows = |var: Var| tape.value(var).rows();
    assert!(rows(points) == neighbors.points() && rows(nodes) == neighbors.nodes(), "weights: other neighbours");
    let per_node = [Some(log_radii), gates].into_iter().flatten();
    assert!(per_node.clone().all(|var| tape.value(var).len() == neighbors.nodes()), "weights: one value per node");
    let inputs: Vec<Var> = [points, nodes].into_iter().chain(per_node).collect();
    tape.apply_one(Weights { neighbors: neighbors.clone() }, &inputs)
}

struct Weights {
    neighbors: Neighbors,
}

/// The inputs of the operation, named.
struct Inputs<'a, T: Real> {
    points: &'a Tensor<T>,
    nodes: &'a Tensor<T>,
    log_radii: &'a [T],
    gates: Option<&'a [T]>,
}

/// One point and one of its nodes.
struct Pair<T> {
    squared_distance: T,
    /// 1 / r²
    inverse_variance: T,
    /// e^(−d² / 2r²)
    falloff: T,
    /// σ(g)
    gate: T,
}

impl<'a, T: Real> Inputs<'a, T> {
    fn new(inputs: &[&'a Tensor<T>]) -> Self {
        let gates = inputs.get(3).map(|gates| gates.as_slice());
        Self { points: inputs[0], nodes: inputs[1], log_radii: inputs[2].as_slice(), gates }
    }

    fn pair(&self, point: usize, node: usize) -> Pair<T> {
        let (x, p) = (self.points.row(point), self.nodes.row(node));
        let squared_distance = x.iter().zip(p).map(|(&x, &p)| (x - p) * (x - p)).sum();
        let inverse_variance = (T::from_f64(-2.0) * self.log_radii[node]).exp();
        let falloff = (T::from_f64(-0.5) * squared_distance * inverse_variance).exp();
        let gate = self.gates.map_or(T::ONE, |gates| logistic(gates[node]));
        Pair { squared_distance, inverse_variance, falloff, gate }
    }

    /// Writes the weights of a point; returns the sum that they were divided by.
    fn weights(&self, point: usize, nodes: &[u32], out: &mut [T]) -> T {
        for (out, &node) in out.iter_mut().zip(nodes) {
            let pair = self.pair(point, node as usize);
            *out = pair.falloff * pair.gate + T::from_f64(FLOOR);
        }
        let total: T = out.iter().copied().sum();
        out.iter_mut().for_each(|out| *out /= total);
        total
    }
}

/// 1 / (1 + e⁻ˣ) without overflow.
fn logistic<T: Real>(x: T) -> T {
    let decay = (-x.abs()).exp();
    let tail = decay / (T::ONE + decay);
    if x >= T::ZERO { T::ONE / (T::ONE + decay) } else { tail }
}

impl<T: Real> Op<T> for Weights {
    fn name(&self) -> &'static str {
        "neighbor_weights"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (inputs, per_point) = (Inputs::new(inputs), self.neighbors.per_point());
        let mut weights = vec![T::ZERO; self.neighbors.points() * per_point];
        for_each_row(&mut weights, per_point, |point, out| {
            inputs.weights(point, self.neighbors.of_point(point), out);
        });
        vec![Tensor::from_vec([self.neighbors.points(), per_point], weights)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, needs, .. } = pass;
        let dweights = pass.dy();
        let named = Inputs::new(inputs);
        let unnormalised = self.before_division(&named, outputs[0], dweights);
        let to_points = needs[0].then(|| self.to_points(&named, &unnormalised));
        let [to_nodes, to_radii, to_gates] = self.to_nodes(&named, &unnormalised);
        let mut gradients = vec![to_points, Some(to_nodes), Some(to_radii)];
        gradients.extend(named.gates.map(|_| Some(to_gates)));
        gradients
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Weights {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::weights(gpu, &self.neighbors, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, .. } = pass;
        gpu::weights_backward(gpu, &self.neighbors, inputs, [outputs[0], pass.dy()])
    }
}

impl Weights {
    /// The gradient of every weight before the division by their sum: (dwₖ − Σⱼ wⱼdwⱼ) / sum.
    fn before_division<T: Real>(&self, inputs: &Inputs<T>, weights: &Tensor<T>, dweights: &Tensor<T>) -> Vec<T> {
        let per_point = self.neighbors.per_point();
        let mut out = vec![T::ZERO; dweights.len()];
        for_each_row(&mut out, per_point, |point, out| {
            let total = inputs.weights(point, self.neighbors.of_point(point), out);
            let (weights, dweights) = (weights.row(point), dweights.row(point));
            let along: T = weights.iter().zip(dweights).map(|(&weight, &dweight)| weight * dweight).sum();
            out.iter_mut().zip(dweights).for_each(|(out, &dweight)| *out = (dweight - along) / total);
        });
        out
    }

    fn to_points<T: Real>(&self, inputs: &Inputs<T>, unnormalised: &[T]) -> Tensor<T> {
        let (per_point, columns) = (self.neighbors.per_point(), inputs.points.row_len());
        let mut out = vec![T::ZERO; inputs.points.len()];
        for_each_row(&mut out, columns, |point, out| {
            for (rank, &node) in self.neighbors.of_point(point).iter().enumerate() {
                let pair = inputs.pair(point, node as usize);
                let pull = -unnormalised[point * per_point + rank] * pair.gate * pair.falloff * pair.inverse_variance;
                let difference = inputs.points.row(point).iter().zip(inputs.nodes.row(node as usize));
                out.iter_mut().zip(difference).for_each(|(out, (&x, &p))| *out += pull * (x - p));
            }
        });
        Tensor::from_vec(inputs.points.shape(), out)
    }

    /// The gradients of positions, logarithmic radii and gates.
    fn to_nodes<T: Real>(&self, inputs: &Inputs<T>, unnormalised: &[T]) -> [Tensor<T>; 3] {
        let (per_point, axes) = (self.neighbors.per_point(), inputs.nodes.row_len());
        let mut joined = vec![T::ZERO; inputs.nodes.rows() * (axes + 2)];
        for_each_row(&mut joined, axes + 2, |node, out| {
            for (point, rank) in self.neighbors.followers(node) {
                let (pair, dweight) = (inputs.pair(point, node), unnormalised[point * per_point + rank]);
                let pull = dweight * pair.gate * pair.falloff * pair.inverse_variance;
                let difference = inputs.points.row(point).iter().zip(inputs.nodes.row(node));
                out.iter_mut().zip(difference).for_each(|(out, (&x, &p))| *out += pull * (x - p));
                out[axes] += pull * pair.squared_distance;
                out[axes + 1] += dweight * pair.falloff * pair.gate * (T::ONE - pair.gate);
            }
        });
        let cut = |first: usize, count: usize, shape: Vec<usize>| {
            let rows = joined.chunks_exact(axes + 2).flat_map(|row| &row[first..first + count]).copied().collect();
            Tensor::from_vec(shape, rows)
        };
        let per_node = || vec![inputs.nodes.rows(), 1];
        [cut(0, axes, inputs.nodes.shape().to_vec()), cut(axes, 1, per_node()), cut(axes + 1, 1, per_node())]
    }
}
