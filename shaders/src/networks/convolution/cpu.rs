//! Matrix products over gathered patches, in chunks of pixels whose sums are added in order.

use rayon::prelude::*;

use super::{InputGradients, Layout, add};
use crate::networks::linear::matrix::Matrix;
use crate::networks::linear::multiply;
use crate::tape::Real;
use crate::tape::chunks::map_chunks;

/// Pixels per chunk: the patches of a 3×3 kernel over 64 channels take 0.6 MB and stay in the second-level cache.
const PIXELS_PER_CHUNK: usize = 256;

/// y = patches(x)·Wᵀ + b.
pub(super) fn forward<T: Real>(layout: &Layout, x: &[T], weight: &[T], bias: &[T], y: &mut [T]) {
    let &Layout { channels, outputs, .. } = layout;
    let columns = layout.taps() * channels;
    y.par_chunks_mut(PIXELS_PER_CHUNK * outputs).enumerate().for_each(|(chunk, y)| {
        let first = chunk * PIXELS_PER_CHUNK;
        let patches = patches(x, channels, layout.taps(), first..first + y.len() / outputs, |pixel, tap| {
            layout.source(pixel, tap)
        });
        multiply(Matrix::new(&patches, columns), Matrix::new(weight, columns).transposed(), y);
        y.chunks_exact_mut(outputs).for_each(|row| add(row, bias));
    });
}

/// dW = dyᵀ·patches(x), db = Σ dy, and dx = patches(dy)·Wᵗ with the patches that meet an input pixel.
pub(super) fn backward<T: Real>(
    layout: &Layout,
    x: &[T],
    weight: &[T],
    dy: &[T],
    needs: [bool; 3],
) -> InputGradients<T> {
    let outputs = layout.outputs;
    let dbias = || {
        let mut sum = vec![T::ZERO; outputs];
        dy.chunks_exact(outputs).for_each(|row| add(&mut sum, row));
        sum
    };
    InputGradients {
        x: needs[0].then(|| backward_input(layout, weight, dy, x.len())),
        weight: needs[1].then(|| backward_weight(layout, x, dy)),
        bias: needs[2].then(dbias),
    }
}

fn backward_weight<T: Real>(layout: &Layout, x: &[T], dy: &[T]) -> Vec<T> {
    let &Layout { channels, outputs, .. } = layout;
    let columns = layout.taps() * channels;
    let sums = map_chunks(layout.output_pixels(), PIXELS_PER_CHUNK, |pixels| {
        let dy = &dy[pixels.start * outputs..pixels.end * outputs];
        let patches = patches(x, channels, layout.taps(), pixels, |pixel, tap| layout.source(pixel, tap));
        let mut sum = vec![T::ZERO; outputs * columns];
        multiply(Matrix::new(dy, outputs).transposed(), Matrix::new(&patches, columns), &mut sum);
        sum
    });
    let mut total = vec![T::ZERO; outputs * columns];
    sums.iter().for_each(|sum| add(&mut total, sum));
    total
}

fn backward_input<T: Real>(layout: &Layout, weight: &[T], dy: &[T], len: usize) -> Vec<T> {
    let &Layout { channels, outputs, .. } = layout;
    let taps = layout.taps();
    // [O, taps, C] → [taps, O, C]
    let by_tap =
        |tap: usize| (0..outputs).flat_map(move |output| &weight[(output * taps + tap) * channels..][..channels]);
    let weight_by_tap: Vec<T> = (0..taps).flat_map(by_tap).copied().collect();
    let mut dx = vec![T::ZERO; len];
    dx.par_chunks_mut(PIXELS_PER_CHUNK * channels).enumerate().for_each(|(chunk, dx)| {
        let first = chunk * PIXELS_PER_CHUNK;
        let patches =
            patches(dy, outputs, taps, first..first + dx.len() / channels, |pixel, tap| layout.target(pixel, tap));
        multiply(Matrix::new(&patches, taps * outputs), Matrix::new(&weight_by_tap, channels), dx);
    });
    dx
}

/// [pixels, taps, channels]: the pixel of `image` that `locate` returns for every pixel and tap, zeros for `None`.
fn patches<T: Real>(
    image: &[T],
    channels: usize,
    taps: usize,
    pixels: std::ops::Range<usize>,
    locate: impl Fn(usize, usize) -> Option<usize>,
) -> Vec<T> {
    let mut patches = Vec::with_capacity(pixels.len() * taps * channels);
    for pixel in pixels {
        for tap in 0..taps {
            match locate(pixel, tap) {
                Some(found) => patches.extend_from_slice(&image[found * channels..][..channels]),
                None => patches.resize(patches.len() + channels, T::ZERO),
            }
        }
    }
    patches
}
