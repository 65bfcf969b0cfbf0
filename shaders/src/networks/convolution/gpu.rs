//! The kernels of convolutions: matrix products whose operands are gathered as they are loaded.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::central_difference::CentralDifference;
use super::{Convolution, Layout};
use crate::gpu::grouped::Grouped;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::networks::linear::product::{self, Product};
use crate::tape::{Real, Tensor};

const CONVOLUTION: Grouped = Grouped {
    kernel: Kernel { name: "convolution", text: include_str!("convolution.wgsl") },
    shared: 0,
    arrays: product::EACH_ARRAYS,
};
const CENTRAL: Kernel = Kernel { name: "central difference", text: include_str!("central_difference.wgsl") };

uniforms! {
    struct CentralBlock as "Central" {
        len: u32,
        taps: u32,
        channels: u32,
        theta: f32,
    }
}

/// Which of the three products.
#[derive(Clone, Copy)]
enum Direction {
    /// y = patches(x)·Wᵀ + b.
    Forward,
    /// dx = patches(dy)·Wᵗ, with the patches that meet an input pixel.
    Input,
    /// dW = dyᵀ·patches(x), with db, the sums of the rows of dyᵀ.
    Weight,
}

impl Layout {
    /// The specialisation of the kernel of a direction.
    fn specialisation(&self, direction: Direction) -> Vec<(&'static str, u32)> {
        let is = |wanted: bool| usize::from(wanted);
        let (forward, weight) = (matches!(direction, Direction::Forward), matches!(direction, Direction::Weight));
        let sizes = [
            ("DIRECTION", direction as usize),
            ("INPUT_HEIGHT", self.input[0]),
            ("INPUT_WIDTH", self.input[1]),
            ("OUTPUT_HEIGHT", self.output[0]),
            ("OUTPUT_WIDTH", self.output[1]),
            ("KERNEL_WIDTH", self.kernel[1]),
            ("TAPS", self.taps()),
            ("CHANNELS", self.channels),
            ("OUTPUTS", self.outputs),
            ("PIXEL_STRIDE", self.sampling.stride),
            ("DILATION", self.sampling.dilation),
            ("PADDING", self.sampling.padding),
            ("A_BY_TERM", is(!weight)),
            ("B_BY_TERM", is(forward)),
            ("BIAS", is(forward)),
            ("RELU", 0),
            ("MASK", 0),
            ("SUMS", is(weight)),
        ];
        sizes.map(|(name, size)| (name, size as u32)).to_vec()
    }

    /// Rows, columns and terms of the product of a direction.
    fn sizes(&self, direction: Direction) -> [usize; 3] {
        let (taps, channels, outputs) = (self.taps(), self.channels, self.outputs);
        match direction {
            Direction::Forward => [self.output_pixels(), outputs, taps * channels],
            Direction::Input => [self.input[0] * self.input[1], channels, taps * outputs],
            Direction::Weight => [outputs, taps * channels, self.output_pixels()],
        }
    }

    /// The product; `side` is the bias where the direction has one.
    fn product<'a>(&self, direction: Direction, a: &'a GpuArray, b: &'a GpuArray, side: &'a GpuArray) -> Product<'a> {
        let [rows, columns, terms] = self.sizes(direction);
        Product { rows, columns, terms, strides: [0; 4], arrays: [a, b, side].map(Binding::Read) }
    }

    fn launch(&self, gpu: Gpu, direction: Direction, arrays: [&GpuArray; 3]) -> GpuArray {
        let [a, b, side] = arrays;
        let product = self.product(direction, a, b, side);
        let y = GpuArray::new(gpu, product.rows * product.columns);
        product::each(gpu, &CONVOLUTION, &self.specialisation(direction), &[product], &[(Binding::Write(&y), false)]);
        y
    }
}

impl Convolution {
    pub(super) fn forward_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let Layout { output: [height, width], outputs, .. } = self.layout;
        let [x, weight, bias] = [0, 1, 2].map(|input| inputs[input].on_gpu(gpu));
        let y = self.layout.launch(gpu, Direction::Forward, [x, weight, bias]);
        Tensor::from_gpu([height, width, outputs], y)
    }

    /// The requested gradients of the inputs.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        dy: &Tensor<T>,
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let [x, weight, bias] = [0, 1, 2].map(|input| inputs[input].on_gpu(gpu));
        let dy = dy.on_gpu(gpu);
        let like = |input: usize, array: GpuArray| Some(Tensor::from_gpu(inputs[input].shape(), array));
        let mut gradients = vec![None; 3];
        if needs[0] {
            let dx = self.layout.launch(gpu, Direction::Input, [dy, weight, bias]);
            gradients[0] = like(0, dx);
        }
        if needs[1] || needs[2] {
            let product = self.layout.product(Direction::Weight, dy, x, bias);
            let [of_weight, of_bias] =
                [product.rows * product.columns, product.rows].map(|len| GpuArray::new(gpu, len));
            let specialisation = self.layout.specialisation(Direction::Weight);
            let outputs = [&of_weight, &of_bias].map(|array| (Binding::Write(array), false));
            product::with_sums(gpu, &CONVOLUTION, &specialisation, (&[product], &[outputs]));
            gradients[1] = like(1, of_weight);
            gradients[2] = like(2, of_bias);
        }
        gradients
    }
}

impl CentralDifference {
    /// The reduced weights or, where `is_backward`, the gradient of the weights from that of the reduced ones.
    pub(super) fn reduce_on_gpu<T: Real>(&self, gpu: Gpu, weight: &Tensor<T>, is_backward: bool) -> Tensor<T> {
        let reduced = GpuArray::new(gpu, weight.len());
        let [len, taps, channels] = [weight.len(), self.taps, self.channels].map(|size| size as u32);
        let block = CentralBlock { len, taps, channels, theta: self.theta as f32 };
        let arrays = [Binding::Read(weight.on_gpu(gpu)), Binding::Write(&reduced)];
        let backward = ("BACKWARD", u32::from(is_backward));
        CENTRAL.launch(gpu, &[backward], &block, &arrays, Groups::Over(reduced.len()));
        Tensor::from_gpu(weight.shape(), reduced)
    }
}
