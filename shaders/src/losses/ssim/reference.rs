use super::{Layout, Moments, RADIUS, TAPS, similarity, weights};
use crate::tape::Real;

/// Σ SSIM over the windows that count; their derivatives into `gradients` ([H] rows of d_x, d_xx and d_xy).
pub(super) fn forward<T: Real>(layout: &Layout, x: &[T], y: &[T], gradients: &mut [T]) -> f64 {
    let (row_len, mut sum) = (layout.row_len(), 0.0);
    for row in (0..layout.height).filter(|&row| layout.counts_row(row)) {
        for column in layout.counted_columns() {
            let mut moments = Moments { x: T::ZERO, y: T::ZERO, xx: T::ZERO, yy: T::ZERO, xy: T::ZERO };
            for_each_tap(layout, row, column, |index, weight: T| {
                moments.x += weight * x[index];
                moments.y += weight * y[index];
                moments.xx += weight * x[index] * x[index];
                moments.yy += weight * y[index] * y[index];
                moments.xy += weight * x[index] * y[index];
            });
            let similarity = similarity(moments);
            sum += similarity.value.to_f64();
            for (kind, derivative) in [similarity.d_x, similarity.d_xx, similarity.d_xy].into_iter().enumerate() {
                gradients[(3 * row + kind) * row_len + column] = derivative;
            }
        }
    }
    sum
}

/// dx of Σ SSIM: every window passes its derivatives on to the pixels under it.
pub(super) fn backward<T: Real>(layout: &Layout, x: &[T], y: &[T], gradients: &[T], dx: &mut [T]) {
    let row_len = layout.row_len();
    for row in 0..layout.height {
        for column in 0..row_len {
            let [d_x, d_xx, d_xy] = [0, 1, 2].map(|kind| gradients[(3 * row + kind) * row_len + column]);
            for_each_tap(layout, row, column, |index, weight: T| {
                dx[index] += weight * (d_x + (d_xx + d_xx) * x[index] + d_xy * y[index]);
            });
        }
    }
}

/// Calls `body(element, weight)` for the elements of one channel under the window at (row, column).
fn for_each_tap<T: Real>(layout: &Layout, row: usize, column: usize, mut body: impl FnMut(usize, T)) {
    let weights = weights::<T>();
    let (row_len, channels) = (layout.row_len(), layout.channels);
    for (tap_y, &weight_y) in weights.iter().enumerate() {
        for (tap_x, &weight_x) in weights.iter().enumerate().take(TAPS) {
            let (y, x) = (row + tap_y, column + channels * tap_x);
            let inside_y = (RADIUS..RADIUS + layout.height).contains(&y);
            if inside_y && (channels * RADIUS..channels * RADIUS + row_len).contains(&x) {
                body((y - RADIUS) * row_len + x - channels * RADIUS, weight_y * weight_x);
            }
        }
    }
}
