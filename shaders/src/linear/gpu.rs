//! The kernel of the layer: one matrix product for each direction.

use super::product::{PRODUCT, Product};
use super::{Activation, Linear};
use crate::gpu::{Gpu, GpuArray, Kernel};
use crate::tape::{Real, Tensor};

const LINEAR: Kernel = Kernel { name: "linear", text: &[PRODUCT, include_str!("operands.wgsl")] };

/// What is special about each of the three products.
#[derive(Clone, Copy)]
enum Direction {
    /// y = f(x·Wᵀ + b).
    Forward,
    /// dx = dz·W.
    Inputs,
    /// dW = dzᵀ·x with db, the sums of the rows of dzᵀ.
    Weights,
}

impl Direction {
    fn specialisation(self, activation: Activation) -> [(&'static str, u32); 6] {
        let relu = u32::from(activation == Activation::Relu);
        let [a_by_term, b_by_term, bias, relu, mask, sums] = match self {
            Self::Forward => [1, 1, 1, relu, 0, 0],
            Self::Inputs => [1, 0, 0, 0, relu, 0],
            Self::Weights => [0, 0, 0, 0, relu, 1],
        };
        [
            ("A_BY_TERM", a_by_term),
            ("B_BY_TERM", b_by_term),
            ("BIAS", bias),
            ("RELU", relu),
            ("MASK", mask),
            ("SUMS", sums),
        ]
    }

    /// Rows, columns and terms for `count` rows of x, and the strides of the operands.
    fn sizes(self, count: usize, inputs: usize, outputs: usize) -> ([usize; 3], [usize; 4]) {
        match self {
            Self::Forward => ([count, outputs, inputs], [inputs, 1, 1, inputs]),
            Self::Inputs => ([count, inputs, outputs], [outputs, 1, inputs, 1]),
            Self::Weights => ([outputs, inputs, count], [1, outputs, inputs, 1]),
        }
    }
}

impl Linear {
    /// A·B, and the sums of the rows of A where they are made, for `count` rows of x.
    fn product(&self, gpu: Gpu, direction: Direction, count: usize, arrays: [&GpuArray; 4]) -> [GpuArray; 2] {
        let ([rows, columns, terms], strides) = direction.sizes(count, self.inputs, self.outputs);
        let specialisation = &direction.specialisation(self.activation);
        let in_parts = matches!(direction, Direction::Weights);
        Product { kernel: &LINEAR, specialisation, rows, columns, terms, strides, arrays, in_parts }.launch(gpu)
    }

    pub(super) fn forward_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let [x, weight, bias] = [inputs[0], inputs[1], inputs[2]].map(|input| input.on_gpu(gpu));
        let rows = inputs[0].rows();
        let [y, _] = self.product(gpu, Direction::Forward, rows, [x, weight, x, bias]);
        Tensor::from_gpu([rows, self.outputs], y)
    }

    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        y: &Tensor<T>,
        dy: &Tensor<T>,
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let (rows, x, weight) = (inputs[0].rows(), inputs[0].on_gpu(gpu), inputs[1].on_gpu(gpu));
        let (y, dy) = (y.on_gpu(gpu), dy.on_gpu(gpu));
        let like = |input: usize, array: GpuArray| Some(Tensor::from_gpu(inputs[input].shape(), array));
        let mut gradients = vec![None; 3];
        if needs[0] {
            let [dx, _] = self.product(gpu, Direction::Inputs, rows, [dy, weight, y, weight]);
            gradients[0] = like(0, dx);
        }
        if needs[1] || needs[2] {
            let [weights, biases] = self.product(gpu, Direction::Weights, rows, [dy, x, y, weight]);
            gradients[1] = like(1, weights);
            gradients[2] = like(2, biases);
        }
        gradients
    }
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid_in_every_direction() {
    use super::product::assert_valid_product;
    for direction in [Direction::Forward, Direction::Inputs, Direction::Weights] {
        for activation in [Activation::Identity, Activation::Relu] {
            assert_valid_product(&LINEAR, &direction.specialisation(activation));
        }
    }
}
