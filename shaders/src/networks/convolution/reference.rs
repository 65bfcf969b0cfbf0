//! The defining equation, tap by tap.

use super::{InputGradients, Layout, add};
use crate::tape::Real;

/// (output pixel, tap, input pixel) of every product that is not in the padding.
fn products(layout: &Layout) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
    let pairs = (0..layout.output_pixels()).flat_map(|pixel| (0..layout.taps()).map(move |tap| (pixel, tap)));
    pairs.filter_map(|(pixel, tap)| Some((pixel, tap, layout.source(pixel, tap)?)))
}

pub(super) fn forward<T: Real>(layout: &Layout, x: &[T], weight: &[T], bias: &[T], y: &mut [T]) {
    let &Layout { channels, outputs, .. } = layout;
    y.chunks_exact_mut(outputs).for_each(|row| row.copy_from_slice(bias));
    for (pixel, tap, source) in products(layout) {
        let x = &x[source * channels..][..channels];
        for output in 0..outputs {
            let weight = &weight[(output * layout.taps() + tap) * channels..][..channels];
            y[pixel * outputs + output] += x.iter().zip(weight).map(|(&x, &weight)| x * weight).sum();
        }
    }
}

pub(super) fn backward<T: Real>(
    layout: &Layout,
    x: &[T],
    weight: &[T],
    dy: &[T],
    needs: [bool; 3],
) -> InputGradients<T> {
    let &Layout { channels, outputs, .. } = layout;
    let (mut dx, mut dweight, mut dbias) =
        (vec![T::ZERO; x.len()], vec![T::ZERO; weight.len()], vec![T::ZERO; outputs]);
    dy.chunks_exact(outputs).for_each(|row| add(&mut dbias, row));
    for (pixel, tap, source) in products(layout) {
        for output in 0..outputs {
            let dy = dy[pixel * outputs + output];
            for channel in 0..channels {
                let (at_x, at_weight) =
                    (source * channels + channel, (output * layout.taps() + tap) * channels + channel);
                dx[at_x] += dy * weight[at_weight];
                dweight[at_weight] += dy * x[at_x];
            }
        }
    }
    InputGradients { x: needs[0].then_some(dx), weight: needs[1].then_some(dweight), bias: needs[2].then_some(dbias) }
}
