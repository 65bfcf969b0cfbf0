//! Layers of image classifiers: convolution with ReLU, and max pooling; forward only, in f32.

use rayon::prelude::*;

/// Values per chunk of gathered patches: 4 MB, about the second- and third-level cache of one core.
const PATCH_VALUES: usize = 1 << 20;

/// Features [H, W, C], with channels contiguous.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Activation {
    /// Height in pixels.
    pub(crate) height: usize,
    /// Width in pixels.
    pub(crate) width: usize,
    /// Number of channels.
    pub(crate) channels: usize,
    /// The values, [H, W, C].
    pub(crate) values: Vec<f32>,
}

/// A square window of a convolution or a pooling layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Side length in pixels.
    pub(crate) size: usize,
    /// Distance between windows in pixels.
    pub(crate) stride: usize,
    /// Zero padding on each side of the input.
    pub(crate) padding: usize,
    /// Whether windows may end outside the input (`ceil_mode`).
    pub(crate) partial: bool,
}

impl Window {
    /// Number of windows along an input side; `None` if no window fits.
    pub(crate) fn outputs(self, input: usize) -> Option<usize> {
        let beyond = (input + 2 * self.padding).checked_sub(self.size)?;
        let steps = if self.partial { beyond.div_ceil(self.stride) } else { beyond / self.stride };
        Some(steps + 1)
    }
}

/// A convolution (mathematically a correlation) followed by ReLU.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    window: Window,
    inputs: usize,
    outputs: usize,
    /// [window, window, inputs, outputs].
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Convolution {
    /// Takes weights [outputs, inputs, window, window] and a bias [outputs].
    pub(crate) fn new(window: Window, inputs: usize, weights: &[f32], bias: Vec<f32>) -> Self {
        let (outputs, taps) = (bias.len(), window.size * window.size);
        assert_eq!(weights.len(), outputs * inputs * taps, "the weights have another shape");
        let at = |index: usize| {
            let (output, patch) = (index % outputs, index / outputs);
            weights[(output * inputs + patch % inputs) * taps + patch / inputs]
        };
        Self { window, inputs, outputs, weights: (0..weights.len()).map(at).collect(), bias }
    }

    /// max(0, W ∗ x + b). The image must be large enough for one window. The result does not depend on the number of
    /// threads.
    pub(crate) fn forward(&self, x: &Activation) -> Activation {
        assert_eq!(x.channels, self.inputs, "the image has another number of channels");
        let side = |input| self.window.outputs(input).expect("an image of at least one window");
        let (height, width) = (side(x.height), side(x.width));
        let mut values = vec![0.0; height * width * self.outputs];
        let patch_len = self.window.size * self.window.size * self.inputs;
        let pixels_per_chunk = (PATCH_VALUES / patch_len).max(1);
        values.par_chunks_mut(pixels_per_chunk * self.outputs).enumerate().for_each(|(chunk, out)| {
            let first = chunk * pixels_per_chunk;
            let pixels = first..first + out.len() / self.outputs;
            let mut patches = Vec::with_capacity(pixels.len() * patch_len);
            pixels.for_each(|pixel| self.gather(x, pixel / width, pixel % width, &mut patches));
            multiply(&patches, &self.weights, [patch_len, self.outputs], out);
            for row in out.chunks_exact_mut(self.outputs) {
                row.iter_mut().zip(&self.bias).for_each(|(value, bias)| *value = (*value + bias).max(0.0));
            }
        });
        Activation { height, width, channels: self.outputs, values }
    }

    /// Appends the input patch of the output at (row, column), with zeros beyond the border.
    fn gather(&self, x: &Activation, row: usize, column: usize, patches: &mut Vec<f32>) {
        let Window { size, stride, padding, .. } = self.window;
        for window_row in 0..size {
            let source_row = (row * stride + window_row).wrapping_sub(padding);
            for window_column in 0..size {
                let source_column = (column * stride + window_column).wrapping_sub(padding);
                if source_row < x.height && source_column < x.width {
                    let first = (source_row * x.width + source_column) * x.channels;
                    patches.extend_from_slice(&x.values[first..first + x.channels]);
                } else {
                    patches.resize(patches.len() + x.channels, 0.0);
                }
            }
        }
    }
}

/// out [M, N] = lhs [M, K] · rhs [K, N], all row-major, on one thread; the third argument is [K, N].
fn multiply(lhs: &[f32], rhs: &[f32], [inner, columns]: [usize; 2], out: &mut [f32]) {
    let rows = lhs.len() / inner;
    assert!(lhs.len() == rows * inner && rhs.len() == inner * columns && out.len() == rows * columns);
    // The kernel prefers columns of its output in memory: outᵀ = rhsᵀ·lhsᵀ.
    // SAFETY: the strides are those of row-major matrices with the asserted sizes, and `out` is exclusively borrowed.
    unsafe {
        gemm_f32::gemm::f32::get_gemm_fn()(
            columns,
            rows,
            inner,
            out.as_mut_ptr(),
            columns as isize,
            1,
            false,
            rhs.as_ptr(),
            columns as isize,
            1,
            lhs.as_ptr(),
            inner as isize,
            1,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm_common::Parallelism::None,
        );
    }
}

/// Max pooling per channel; pixels beyond the border are ignored.
pub(crate) fn max_pool(x: &Activation, window: Window) -> Activation {
    let side = |input| window.outputs(input).expect("an image of at least one window");
    let (height, width, channels) = (side(x.height), side(x.width), x.channels);
    let mut values = vec![f32::NEG_INFINITY; height * width * channels];
    values.par_chunks_mut(width * channels).enumerate().for_each(|(row, out)| {
        let rows = row * window.stride..(row * window.stride + window.size).min(x.height);
        for (column, out) in out.chunks_exact_mut(channels).enumerate() {
            let columns = column * window.stride..(column * window.stride + window.size).min(x.width);
            for source in rows.clone().flat_map(|row| columns.clone().map(move |column| row * x.width + column)) {
                let seen = &x.values[source * channels..][..channels];
                out.iter_mut().zip(seen).for_each(|(most, value)| *most = most.max(*value));
            }
        }
    });
    Activation { height, width, channels, values }
}

/// Concatenates the channels of two images of equal size.
pub(crate) fn join(a: &Activation, b: &Activation) -> Activation {
    let channels = a.channels + b.channels;
    let pixels = a.values.chunks_exact(a.channels).zip(b.values.chunks_exact(b.channels));
    let mut values = Vec::with_capacity(a.values.len() + b.values.len());
    pixels.for_each(|(a, b)| {
        values.extend_from_slice(a);
        values.extend_from_slice(b);
    });
    Activation { channels, values, ..*a }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image [H, W, C] of small integers, so that sums are exact.
    fn image(height: usize, width: usize, channels: usize) -> Activation {
        let values = (0..height * width * channels).map(|at| ((7 * at) % 11) as f32 - 3.0).collect();
        Activation { height, width, channels, values }
    }

    /// Computes the convolution by its definition, one output at a time.
    fn by_definition(x: &Activation, window: Window, weights: &[f32], bias: &[f32]) -> Vec<f32> {
        let (height, width) = (window.outputs(x.height).unwrap(), window.outputs(x.width).unwrap());
        let mut out = Vec::new();
        for at in 0..height * width * bias.len() {
            let (output, column, row) = (at % bias.len(), at / bias.len() % width, at / bias.len() / width);
            let mut sum = bias[output];
            for tap in 0..x.channels * window.size * window.size {
                let (j, i, c) = (tap % window.size, tap / window.size % window.size, tap / window.size / window.size);
                let y = (row * window.stride + i) as i64 - window.padding as i64;
                let z = (column * window.stride + j) as i64 - window.padding as i64;
                if (0..x.height as i64).contains(&y) && (0..x.width as i64).contains(&z) {
                    let seen = x.values[(y as usize * x.width + z as usize) * x.channels + c];
                    sum += seen * weights[output * x.channels * window.size * window.size + tap];
                }
            }
            out.push(sum.max(0.0));
        }
        out
    }

    #[test]
    fn convolutions_equal_their_definition() {
        for (size, stride, padding) in [(1, 1, 0), (3, 1, 1), (3, 2, 0), (5, 1, 2), (11, 4, 2)] {
            let window = Window { size, stride, padding, partial: false };
            let x = image(13, 17, 3);
            let weights: Vec<f32> = (0..4 * 3 * size * size).map(|at| ((5 * at) % 7) as f32 - 3.0).collect();
            let bias = vec![1.0, -2.0, 0.0, 3.0];
            let found = Convolution::new(window, 3, &weights, bias.clone()).forward(&x);
            assert_eq!(found.values, by_definition(&x, window, &weights, &bias), "{window:?}");
        }
    }

    #[test]
    fn pooling_handles_partial_windows() {
        let x = Activation { height: 4, width: 4, channels: 1, values: (0..16).map(|at| at as f32).collect() };
        let whole = Window { size: 3, stride: 2, padding: 0, partial: false };
        assert_eq!(max_pool(&x, whole).values, [10.0]);
        assert_eq!(max_pool(&x, Window { partial: true, ..whole }).values, [10.0, 11.0, 14.0, 15.0]);
        assert_eq!(whole.outputs(2), None);
    }

    #[test]
    fn joined_images_have_the_channels_of_both() {
        let (a, b) = (image(2, 2, 2), image(2, 2, 1));
        let joined = join(&a, &b);
        assert_eq!(joined.channels, 3);
        assert_eq!(joined.values[3..6], [a.values[2], a.values[3], b.values[1]]);
    }
}
