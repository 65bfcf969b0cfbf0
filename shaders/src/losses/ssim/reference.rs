use super::{Layout, Moments, RADIUS, Similarity, TAPS, similarity, weights};
use crate::tape::Real;

/// Σ SSIM over the windows that count, and its derivative with respect to every element of x: every window passes its
/// derivatives on to the elements under it.
pub(super) fn sum_and_gradient<T: Real>(layout: &Layout, x: &[T], y: &[T]) -> (f64, Vec<T>) {
    let (weights, mut sum, mut dx) = (weights::<T>(), 0.0, vec![T::ZERO; x.len()]);
    for row in (0..layout.height).filter(|&row| layout.counts_row(row)) {
        for column in layout.counted_columns() {
            let mut moments = Moments { x: T::ZERO, y: T::ZERO, xx: T::ZERO, yy: T::ZERO, xy: T::ZERO };
            for_each_tap(layout, &weights, row, column, |index, weight: T| {
                moments.x += weight * x[index];
                moments.y += weight * y[index];
                moments.xx += weight * x[index] * x[index];
                moments.yy += weight * y[index] * y[index];
                moments.xy += weight * x[index] * y[index];
            });
            let Similarity { value, d_x, d_xx, d_xy } = similarity(moments);
            sum += value.to_f64();
            for_each_tap(layout, &weights, row, column, |index, weight: T| {
                dx[index] += weight * (d_x + (d_xx + d_xx) * x[index] + d_xy * y[index]);
            });
        }
    }
    (sum, dx)
}

/// Calls `body(element, weight)` for the elements of one channel under the window at (row, column).
fn for_each_tap<T: Real>(
    layout: &Layout,
    weights: &[T; TAPS],
    row: usize,
    column: usize,
    mut body: impl FnMut(usize, T),
) {
    let (row_len, channels) = (layout.row_len(), layout.channels);
    for (tap_y, &weight_y) in weights.iter().enumerate() {
        for (tap_x, &weight_x) in weights.iter().enumerate() {
            let (y, x) = (row + tap_y, column + channels * tap_x);
            let inside_y = (RADIUS..RADIUS + layout.height).contains(&y);
            if inside_y && (channels * RADIUS..channels * RADIUS + row_len).contains(&x) {
                body((y - RADIUS) * row_len + x - channels * RADIUS, weight_y * weight_x);
            }
        }
    }
}
