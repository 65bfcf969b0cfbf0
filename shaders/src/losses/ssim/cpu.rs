//! The fast f32 body: the window is separable, so rows are filtered first and columns second.
//!
//! Images stay interleaved: along a row, the neighbour of an element is `channels` elements away.

use rayon::prelude::*;

use super::{Layout, Moments, RADIUS, TAPS, similarity, weights};
use crate::tape::simd::multiversion;

/// Σ SSIM over the windows that count; their derivatives into `gradients` ([H] rows of d_x, d_xx and d_xy).
pub(super) fn forward(layout: &Layout, x: &[f32], y: &[f32], gradients: &mut [f32]) -> f64 {
    let row_len = layout.row_len();
    let mut filtered = vec![0.0; 5 * x.len()];
    filtered.par_chunks_mut(5 * row_len).zip(x.par_chunks(row_len)).zip(y.par_chunks(row_len)).for_each(
        |((filtered, x), y)| {
            filter_row(x, layout.channels, &mut filtered[..row_len]);
            filter_row(y, layout.channels, &mut filtered[row_len..2 * row_len]);
            for (kind, (a, b)) in [(x, x), (y, y), (x, y)].into_iter().enumerate() {
                filter_row(&product(a, b), layout.channels, &mut filtered[(2 + kind) * row_len..(3 + kind) * row_len]);
            }
        },
    );
    let sum_of_row = |(row, gradients): (usize, &mut [f32])| match layout.counts_row(row) {
        true => compare_row(layout, &filter_columns::<5>(&filtered, row_len, row), gradients),
        false => 0.0,
    };
    let sums: Vec<f64> = gradients.par_chunks_mut(3 * row_len).enumerate().map(sum_of_row).collect();
    sums.into_iter().sum()
}

/// dx of Σ SSIM from the derivatives of every window.
pub(super) fn backward(layout: &Layout, x: &[f32], y: &[f32], gradients: &[f32], dx: &mut [f32]) {
    let row_len = layout.row_len();
    let mut filtered = vec![0.0; gradients.len()];
    filtered.par_chunks_mut(row_len).zip(gradients.par_chunks(row_len)).for_each(|(filtered, gradients)| {
        filter_row(gradients, layout.channels, filtered);
    });
    dx.par_chunks_mut(row_len).enumerate().for_each(|(row, dx)| {
        let sums = filter_columns::<3>(&filtered, row_len, row);
        let (x, y) = (&x[row * row_len..][..row_len], &y[row * row_len..][..row_len]);
        let (d_x, d_xx, d_xy) = (&sums[..row_len], &sums[row_len..2 * row_len], &sums[2 * row_len..]);
        for index in 0..row_len {
            dx[index] = d_x[index] + 2.0 * d_xx[index] * x[index] + d_xy[index] * y[index];
        }
    });
}

fn product(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// The row convolved with the window; zeros outside.
fn filter_row(row: &[f32], channels: usize, out: &mut [f32]) {
    let margin = RADIUS * channels;
    let mut padded = vec![0.0; row.len() + 2 * margin];
    padded[margin..margin + row.len()].copy_from_slice(row);
    let taps = std::array::from_fn(|tap| &padded[tap * channels..][..row.len()]);
    weigh(&taps, out);
}

/// Row `row` of an image of `ROWS` interleaved planes ([H] times `ROWS` rows) convolved along the columns; zeros outside.
fn filter_columns<const ROWS: usize>(planes: &[f32], row_len: usize, row: usize) -> Vec<f32> {
    let (len, height) = (ROWS * row_len, planes.len() / (ROWS * row_len));
    let outside = vec![0.0; len];
    let taps = std::array::from_fn(|tap| match (row + tap).checked_sub(RADIUS) {
        Some(y) if y < height => &planes[y * len..][..len],
        _ => outside.as_slice(),
    });
    let mut out = vec![0.0; len];
    weigh(&taps, &mut out);
    out
}

multiversion! {
    /// out = Σ weight·tap, element by element.
    fn weigh(taps: &[&[f32]; TAPS], out: &mut [f32]) = weigh_body
}

#[inline(always)]
fn weigh_body(taps: &[&[f32]; TAPS], out: &mut [f32]) {
    let len = out.len();
    let [t0, t1, t2, t3, t4, t5, t6, t7, t8, t9, t10] = *taps;
    let (t0, t1, t2, t3, t4, t5) = (&t0[..len], &t1[..len], &t2[..len], &t3[..len], &t4[..len], &t5[..len]);
    let (t6, t7, t8, t9, t10) = (&t6[..len], &t7[..len], &t8[..len], &t9[..len], &t10[..len]);
    // The window is symmetric: five sums of two taps and the centre.
    let [w0, w1, w2, w3, w4, w5, ..] = weights::<f32>();
    for i in 0..len {
        let outer = w0 * (t0[i] + t10[i]) + w1 * (t1[i] + t9[i]) + w2 * (t2[i] + t8[i]);
        let inner = w3 * (t3[i] + t7[i]) + w4 * (t4[i] + t6[i]) + w5 * t5[i];
        out[i] = outer + inner;
    }
}

/// Σ SSIM over the windows of one row that count, from the five rows of moments; derivatives into `gradients`.
fn compare_row(layout: &Layout, moments: &[f32], gradients: &mut [f32]) -> f64 {
    let mut values = vec![0.0; layout.row_len()];
    compare(moments, gradients, &mut values);
    let counted = layout.counted_columns();
    for row in gradients.chunks_exact_mut(layout.row_len()) {
        row[..counted.start].fill(0.0);
        row[counted.end..].fill(0.0);
    }
    values[counted].iter().map(|&value| value as f64).sum()
}

multiversion! {
    fn compare(moments: &[f32], gradients: &mut [f32], values: &mut [f32]) = compare_body
}

#[inline(always)]
fn compare_body(moments: &[f32], gradients: &mut [f32], values: &mut [f32]) {
    let len = values.len();
    let (x, rest) = moments.split_at(len);
    let (y, rest) = rest.split_at(len);
    let (xx, rest) = rest.split_at(len);
    let (yy, xy) = rest.split_at(len);
    let (d_x, rest) = gradients.split_at_mut(len);
    let (d_xx, d_xy) = rest.split_at_mut(len);
    let (xy, d_xy) = (&xy[..len], &mut d_xy[..len]);
    for i in 0..len {
        let result = similarity(Moments { x: x[i], y: y[i], xx: xx[i], yy: yy[i], xy: xy[i] });
        values[i] = result.value;
        d_x[i] = result.d_x;
        d_xx[i] = result.d_xx;
        d_xy[i] = result.d_xy;
    }
}
