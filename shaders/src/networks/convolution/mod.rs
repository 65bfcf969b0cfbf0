//! Convolution of an image with zero padding: y(p) = b + Σₙ w(n)·x(stride·p + dilation·n − padding).
//!
//! x [H, W, C], weight [O, kernel height, kernel width, C], bias `[O]` → y [H′, W′, O] with
//! H′ = ⌊(H + 2·padding − dilation·(kernel height − 1) − 1) / stride⌋ + 1. Channels are innermost, so a tap is
//! contiguous in memory; weights of other programs, [O, C, kernel height, kernel width], must be permuted.
//!
//! The central-difference convolution y(p) = Σₙ w(n)·(x(p + n) − θ·x(p)) (Yu et al. 2020) is an ordinary one whose central
//! weight is reduced by θ·Σₙ w(n): see [`central_difference`].

mod central_difference;
mod cpu;
mod gpu;
mod reference;
#[cfg(test)]
mod tests;

pub use central_difference::central_difference;

use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Where the taps of a kernel fall.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Input pixels between neighbouring output pixels.
    pub stride: usize,
    /// Input pixels between neighbouring taps.
    pub dilation: usize,
    /// Zeros added on every side of the image, pixels.
    pub padding: usize,
}

impl Sampling {
    /// Output as large as the input, for square kernels of odd size.
    pub fn same_size(kernel_size: usize, dilation: usize) -> Self {
        assert!(kernel_size % 2 == 1, "a kernel of even size has no centre");
        Self { stride: 1, dilation, padding: dilation * (kernel_size / 2) }
    }
}

/// y [H′, W′, O] for x [H, W, C], weight [O, kernel height, kernel width, C], bias `[O]`.
pub fn convolution<T: Real>(tape: &mut Tape<T>, x: Var, weight: Var, bias: Var, sampling: Sampling) -> Var {
    let layout = Layout::new(tape.value(x).shape(), tape.value(weight).shape(), sampling);
    assert_eq!(tape.value(bias).len(), layout.outputs, "convolution: bias has the wrong length");
    tape.apply_one(Convolution { layout }, &[x, weight, bias])
}

/// Sizes of one convolution; pairs are (height, width).
#[derive(Copy, Clone)]
struct Layout {
    input: [usize; 2],
    output: [usize; 2],
    kernel: [usize; 2],
    channels: usize,
    outputs: usize,
    sampling: Sampling,
}

impl Layout {
    fn new(x: &[usize], weight: &[usize], sampling: Sampling) -> Self {
        let &[height, width, channels] = x else { panic!("convolution: x must be [H, W, C], not {x:?}") };
        let &[outputs, kernel_height, kernel_width, weight_channels] = weight else {
            panic!("convolution: the weight must be [O, kernel height, kernel width, C], not {weight:?}")
        };
        assert_eq!(channels, weight_channels, "convolution: x and weight differ in channels");
        let Sampling { stride, dilation, padding } = sampling;
        let along = |pixels: usize, taps: usize| {
            let reach = dilation * (taps - 1) + 1;
            assert!(pixels + 2 * padding >= reach, "convolution: the kernel is larger than the padded image");
            (pixels + 2 * padding - reach) / stride + 1
        };
        let output = [along(height, kernel_height), along(width, kernel_width)];
        let (input, kernel) = ([height, width], [kernel_height, kernel_width]);
        Self { input, output, kernel, channels, outputs, sampling }
    }

    fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    fn output_pixels(&self) -> usize {
        self.output[0] * self.output[1]
    }

    /// The input pixel that a tap of an output pixel reads; `None` in the padding.
    fn source(&self, output_pixel: usize, tap: usize) -> Option<usize> {
        let Sampling { stride, dilation, padding } = self.sampling;
        let row = (output_pixel / self.output[1] * stride + tap / self.kernel[1] * dilation).checked_sub(padding)?;
        let column = (output_pixel % self.output[1] * stride + tap % self.kernel[1] * dilation).checked_sub(padding)?;
        (row < self.input[0] && column < self.input[1]).then_some(row * self.input[1] + column)
    }

    /// The output pixel whose tap reads an input pixel, if any: the inverse of [`Layout::source`].
    fn target(&self, input_pixel: usize, tap: usize) -> Option<usize> {
        let Sampling { stride, dilation, padding } = self.sampling;
        let row = (input_pixel / self.input[1] + padding).checked_sub(tap / self.kernel[1] * dilation)?;
        let column = (input_pixel % self.input[1] + padding).checked_sub(tap % self.kernel[1] * dilation)?;
        let on_grid = row.is_multiple_of(stride) && column.is_multiple_of(stride);
        let (row, column) = (row / stride, column / stride);
        (on_grid && row < self.output[0] && column < self.output[1]).then_some(row * self.output[1] + column)
    }
}

struct Convolution {
    layout: Layout,
}

/// The requested gradients of the three inputs.
struct InputGradients<T> {
    x: Option<Vec<T>>,
    weight: Option<Vec<T>>,
    bias: Option<Vec<T>>,
}

impl<T: Real> Op<T> for Convolution {
    fn name(&self) -> &'static str {
        "convolution"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let Layout { output: [height, width], outputs, .. } = self.layout;
        let mut y = vec![T::ZERO; self.layout.output_pixels() * outputs];
        let [x, weight, bias] = [0, 1, 2].map(|input| inputs[input].as_slice());
        if T::as_f32(x).is_some() {
            cpu::forward(&self.layout, x, weight, bias, &mut y);
        } else {
            reference::forward(&self.layout, x, weight, bias, &mut y);
        }
        vec![Tensor::from_vec([height, width, outputs], y)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        let [x, weight] = [0, 1].map(|input| inputs[input].as_slice());
        let needs = [needs[0], needs[1], needs[2]];
        let InputGradients { x, weight, bias } = if T::as_f32(x).is_some() {
            cpu::backward(&self.layout, x, weight, dy.as_slice(), needs)
        } else {
            reference::backward(&self.layout, x, weight, dy.as_slice(), needs)
        };
        let shaped = |(gradient, like): (Option<Vec<T>>, &&Tensor<T>)| Some(Tensor::from_vec(like.shape(), gradient?));
        [x, weight, bias].into_iter().zip(inputs).map(shaped).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Convolution {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.forward_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        self.backward_on_gpu(gpu, inputs, pass.dy(), needs)
    }
}

/// total += term
fn add<T: Real>(total: &mut [T], term: &[T]) {
    total.iter_mut().zip(term).for_each(|(total, &term)| *total += term);
}
