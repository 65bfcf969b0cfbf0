//! The fast f32 body: the window is separable, so rows are filtered first and columns second.
//!
//! Images stay interleaved: along a row, the neighbour of an element is `channels` elements away. Bands of rows run in parallel,
//! and a band keeps only those filtered rows that the next window covers: 0.8 MB at 800 px, i.e. about the cache of a core. It filters
//! the rows that it shares with its neighbours itself, so that the result does not depend on the bands.

use super::{Layout, Moments, RADIUS, TAPS, similarity, weights};
use crate::tape::Real;
use crate::tape::chunks::chunked_with;
use crate::tape::simd::multiversion;

/// The planes x, y, x², y² and xy.
const MOMENTS: usize = 5;
/// The planes d_x, d_xx and d_xy.
const DERIVATIVES: usize = 3;
/// The fewest rows of a band. Shorter ones would mostly filter the rows of their neighbours, up to 20.
const MIN_BAND: usize = 32;

/// Σ SSIM over the windows that count, and its derivative with respect to every element of x; `T` is f32.
pub(super) fn sum_and_gradient<T: Real>(layout: &Layout, x: &[f32], y: &[f32]) -> (f64, Vec<T>) {
    let row_len = layout.row_len();
    let (gradient, sums) = chunked_with(x.len(), band_rows(layout) * row_len, |start, dx| {
        let dx = T::as_f32_mut(dx).expect("T is f32");
        let (first, rows) = (start / row_len, dx.len() / row_len);
        let above = first.min(RADIUS);
        let mut band = Band::new(layout, x, y, first - above);
        let mut sums = Vec::with_capacity(above + rows + RADIUS);
        for (row, dx) in (first..).zip(dx.chunks_exact_mut(row_len)) {
            while band.next < layout.height.min(row + RADIUS + 1) {
                sums.push(band.compare_next_row());
            }
            band.gradient_of_row(row, dx);
        }
        sums[above..above + rows].to_vec()
    });
    (sums.into_iter().flatten().sum(), gradient)
}

/// Rows of a band: two bands per thread, because threads may not start or run equally fast.
fn band_rows(layout: &Layout) -> usize {
    layout.height.div_ceil(2 * rayon::current_num_threads()).max(MIN_BAND)
}

/// The state of a band, whose rows of windows are compared from top to bottom.
struct Band<'a> {
    layout: &'a Layout,
    x: &'a [f32],
    y: &'a [f32],
    /// The next row of windows to compare.
    next: usize,
    /// The next row of the images to filter.
    next_filtered: usize,
    moments: Recent<MOMENTS>,
    derivatives: Recent<DERIVATIVES>,
    filter: RowFilter,
    /// Sums of the planes over the windows of a row.
    windows: Vec<f32>,
    /// The derivatives of the compared row.
    compared: Vec<f32>,
    /// The SSIM of the compared row.
    values: Vec<f32>,
}

impl<'a> Band<'a> {
    fn new(layout: &'a Layout, x: &'a [f32], y: &'a [f32], next: usize) -> Self {
        let row_len = layout.row_len();
        Self {
            layout,
            x,
            y,
            next,
            next_filtered: next.saturating_sub(RADIUS),
            moments: Recent::new(row_len),
            derivatives: Recent::new(row_len),
            filter: RowFilter::new(layout),
            windows: vec![0.0; MOMENTS * row_len],
            compared: vec![0.0; DERIVATIVES * row_len],
            values: vec![0.0; row_len],
        }
    }

    /// Σ SSIM of the next row of windows; its filtered derivatives are kept.
    fn compare_next_row(&mut self) -> f64 {
        let (row, height) = (self.next, self.layout.height);
        self.next += 1;
        while self.next_filtered < height.min(row + RADIUS + 1) {
            self.filter_next_row();
        }
        let mut sum = 0.0;
        if self.layout.counts_row(row) {
            self.moments.filter_columns(row, height, &mut self.windows);
            compare(&self.windows, &mut self.compared, &mut self.values);
            sum = self.count_columns();
        } else {
            self.compared.fill(0.0);
        }
        let derivatives = self.compared.chunks_exact(self.layout.row_len());
        for (derivative, out) in derivatives.zip(self.derivatives.planes_mut(row)) {
            self.filter.apply(out, |padded| padded.copy_from_slice(derivative));
        }
        sum
    }

    fn filter_next_row(&mut self) {
        let (row, row_len) = (self.next_filtered, self.layout.row_len());
        self.next_filtered += 1;
        let [x, y] = [self.x, self.y].map(|image| &image[row * row_len..][..row_len]);
        let mut planes = self.moments.planes_mut(row);
        for image in [x, y] {
            self.filter.apply(planes.next().expect("five planes"), |padded| padded.copy_from_slice(image));
        }
        for (a, b) in [(x, x), (y, y), (x, y)] {
            self.filter.apply(planes.next().expect("five planes"), |padded| multiply(a, b, padded));
        }
    }

    /// Σ SSIM of the windows of the compared row that count; the derivatives of the others become 0.
    fn count_columns(&mut self) -> f64 {
        let counted = self.layout.counted_columns();
        for derivative in self.compared.chunks_exact_mut(self.layout.row_len()) {
            derivative[..counted.start].fill(0.0);
            derivative[counted.end..].fill(0.0);
        }
        self.values[counted].iter().map(|&value| f64::from(value)).sum()
    }

    /// The derivatives with respect to a row of x, once the windows that contain it have been compared.
    fn gradient_of_row(&mut self, row: usize, dx: &mut [f32]) {
        let row_len = self.layout.row_len();
        let windows = &mut self.windows[..DERIVATIVES * row_len];
        self.derivatives.filter_columns(row, self.layout.height, windows);
        let [x, y] = [self.x, self.y].map(|image| &image[row * row_len..][..row_len]);
        chain(windows, x, y, dx);
    }
}

/// The last rows of some planes, filtered along the rows, as many as a window covers.
struct Recent<const PLANES: usize> {
    row_len: usize,
    /// Row y of all planes is at y modulo the number of rows.
    rows: Vec<f32>,
    /// A row outside the image.
    outside: Vec<f32>,
}

impl<const PLANES: usize> Recent<PLANES> {
    fn new(row_len: usize) -> Self {
        Self { row_len, rows: vec![0.0; TAPS * PLANES * row_len], outside: vec![0.0; PLANES * row_len] }
    }

    /// Row `row` of each plane, to be overwritten.
    fn planes_mut(&mut self, row: usize) -> std::slice::ChunksExactMut<'_, f32> {
        let len = PLANES * self.row_len;
        self.rows[row % TAPS * len..][..len].chunks_exact_mut(self.row_len)
    }

    /// Row `row` of all planes, convolved along the columns of an image of this height; zeros outside.
    fn filter_columns(&self, row: usize, height: usize, out: &mut [f32]) {
        let len = PLANES * self.row_len;
        let taps = std::array::from_fn(|tap| match (row + tap).checked_sub(RADIUS) {
            Some(y) if y < height => &self.rows[y % TAPS * len..][..len],
            _ => self.outside.as_slice(),
        });
        weigh(&taps, out);
    }
}

/// Convolves rows with the window.
struct RowFilter {
    channels: usize,
    /// A row between zeros.
    padded: Vec<f32>,
}

impl RowFilter {
    fn new(layout: &Layout) -> Self {
        let channels = layout.channels;
        Self { channels, padded: vec![0.0; layout.row_len() + 2 * RADIUS * channels] }
    }

    /// The convolution of the row that `set` writes.
    fn apply(&mut self, out: &mut [f32], set: impl FnOnce(&mut [f32])) {
        set(&mut self.padded[RADIUS * self.channels..][..out.len()]);
        let taps = std::array::from_fn(|tap| &self.padded[tap * self.channels..][..out.len()]);
        weigh(&taps, out);
    }
}

multiversion! {
    /// out = a·b, element by element.
    fn multiply(a: &[f32], b: &[f32], out: &mut [f32]) = multiply_body
}

#[inline(always)]
fn multiply_body(a: &[f32], b: &[f32], out: &mut [f32]) {
    out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = a * b);
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

multiversion! {
    /// SSIM and its derivatives from the five planes of moments of a row.
    fn compare(moments: &[f32], derivatives: &mut [f32], values: &mut [f32]) = compare_body
}

#[inline(always)]
fn compare_body(moments: &[f32], derivatives: &mut [f32], values: &mut [f32]) {
    let len = values.len();
    let (x, rest) = moments.split_at(len);
    let (y, rest) = rest.split_at(len);
    let (xx, rest) = rest.split_at(len);
    let (yy, xy) = rest.split_at(len);
    let (d_x, rest) = derivatives.split_at_mut(len);
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

multiversion! {
    /// dx from the sums of the derivatives over all windows that contain an element.
    fn chain(windows: &[f32], x: &[f32], y: &[f32], dx: &mut [f32]) = chain_body
}

#[inline(always)]
fn chain_body(windows: &[f32], x: &[f32], y: &[f32], dx: &mut [f32]) {
    let len = dx.len();
    let (d_x, rest) = windows.split_at(len);
    let (d_xx, d_xy) = rest.split_at(len);
    let (d_xy, x, y) = (&d_xy[..len], &x[..len], &y[..len]);
    for i in 0..len {
        dx[i] = d_x[i] + 2.0 * d_xx[i] * x[i] + d_xy[i] * y[i];
    }
}
