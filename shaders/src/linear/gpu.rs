//! The kernel of the layer: one matrix product for each direction.

use super::{Activation, Linear};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::sums::over_rows;
use crate::tape::{Real, Tensor};

const PRODUCT: Kernel = Kernel { name: "linear", text: &[include_str!("product.wgsl")] };

/// Rows and columns of a workgroup's tile.
const TILE: usize = 64;
/// Terms per step of a workgroup; a part of a sum is a multiple of it.
const STEP: usize = 16;
/// Terms that are worth a part of their own.
const LEAST_TERMS: usize = 512;
/// Workgroups that occupy a large GPU.
const ENOUGH_GROUPS: usize = 512;

uniforms! {
    #[derive(Default)]
    struct ProductBlock as "Product" {
        rows: u32,
        columns: u32,
        terms: u32,
        terms_per_part: u32,
        row_tiles: u32,
        column_tiles: u32,
        a_row: u32,
        a_term: u32,
        b_term: u32,
        b_column: u32,
    }
}

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

    /// The sizes for `rows` rows of x, and the strides of the operands.
    fn block(self, rows: usize, inputs: usize, outputs: usize) -> ProductBlock {
        let [count, inputs, outputs] = [rows, inputs, outputs].map(|size| size as u32);
        let strides = |[a_row, a_term, b_term, b_column]: [u32; 4]| ProductBlock {
            a_row,
            a_term,
            b_term,
            b_column,
            ..Default::default()
        };
        match self {
            Self::Forward => {
                ProductBlock { rows: count, columns: outputs, terms: inputs, ..strides([inputs, 1, 1, inputs]) }
            }
            Self::Inputs => {
                ProductBlock { rows: count, columns: inputs, terms: outputs, ..strides([outputs, 1, inputs, 1]) }
            }
            Self::Weights => {
                ProductBlock { rows: outputs, columns: inputs, terms: count, ..strides([1, outputs, inputs, 1]) }
            }
        }
    }
}

impl Linear {
    /// A·B, and the sums of the rows of A where they are made: each in parts, as many as given.
    fn product(
        &self,
        gpu: Gpu,
        direction: Direction,
        rows: usize,
        [a, b, output, bias]: [&GpuArray; 4],
    ) -> (GpuArray, GpuArray, usize) {
        let mut block = direction.block(rows, self.inputs, self.outputs);
        let [height, width, terms] = [block.rows, block.columns, block.terms].map(|size| size as usize);
        let (row_tiles, column_tiles) = (height.div_ceil(TILE), width.div_ceil(TILE));
        let tiles = row_tiles * column_tiles;
        let wanted = match direction {
            Direction::Weights => (ENOUGH_GROUPS / tiles).clamp(1, terms.div_ceil(LEAST_TERMS).max(1)),
            _ => 1,
        };
        let terms_per_part = terms.div_ceil(wanted).max(1).next_multiple_of(STEP);
        let parts = terms.div_ceil(terms_per_part).max(1);
        [block.terms_per_part, block.row_tiles, block.column_tiles] =
            [terms_per_part, row_tiles, column_tiles].map(|size| size as u32);

        let y = GpuArray::new(gpu, parts * height * width);
        let sums = GpuArray::new(gpu, parts * height);
        let read = [a, b, output, bias].map(Binding::Read);
        let arrays = [&read[..], &[Binding::Write(&y), Binding::Write(&sums)]].concat();
        PRODUCT.launch(gpu, &direction.specialisation(self.activation), &block, &arrays, parts * tiles);
        (y, sums, parts)
    }

    pub(super) fn forward_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let [x, weight, bias] = [inputs[0], inputs[1], inputs[2]].map(|input| input.on_gpu(gpu));
        let rows = inputs[0].rows();
        let (y, ..) = self.product(gpu, Direction::Forward, rows, [x, weight, x, bias]);
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
            let (dx, ..) = self.product(gpu, Direction::Inputs, rows, [dy, weight, y, weight]);
            gradients[0] = like(0, dx);
        }
        if needs[1] || needs[2] {
            let (weights, biases, parts) = self.product(gpu, Direction::Weights, rows, [dy, x, y, weight]);
            let sum = |array: GpuArray| if parts == 1 { array } else { over_rows(gpu, &array, array.len() / parts) };
            gradients[1] = like(1, sum(weights));
            gradients[2] = like(2, sum(biases));
        }
        gradients
    }
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid_in_every_direction() {
    use crate::gpu::layout::assert_valid;
    for direction in [Direction::Forward, Direction::Inputs, Direction::Weights] {
        for activation in [Activation::Identity, Activation::Relu] {
            assert_valid::<ProductBlock>(&PRODUCT, &direction.specialisation(activation));
        }
    }
}
