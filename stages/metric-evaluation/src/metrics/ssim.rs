//! Structural similarity (Wang et al., "Image quality assessment: from error visibility to structural similarity",
//! IEEE TIP 2004) with the window of 3D Gaussian Splatting: 11 Gaussian taps, σ = 1.5, population moments, range 1.

/// Number of taps of the separable window.
pub(super) const TAPS: usize = 11;
/// Taps to either side of the centre.
pub(super) const RADIUS: usize = TAPS / 2;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// Stabilises the luminance: (0.01 L)² for the range L = 1.
const C1: f64 = 1e-4;
/// Stabilises contrast and structure: (0.03 L)² for the range L = 1.
const C2: f64 = 9e-4;

/// Means of the SSIM map of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SsimMeans {
    /// Mean over all pixels; windows are padded with zeros (black) beyond the border.
    pub(super) zero_padded: f64,
    /// Mean over the pixels whose window is inside the image; `None` without such a pixel.
    pub(super) valid: Option<f64>,
    /// Mean of contrast times structure over the pixels whose window is inside the image (a factor of MS-SSIM).
    pub(super) contrast_structure_valid: Option<f64>,
}

/// Window means of a, b, a² + b² and ab. SSIM needs only the sum of the variances, which saves a fifth mean.
type Moments = [f64; 4];

/// SSIM of two row-major channels in [0, 1] with rows of `width` pixels.
pub(super) fn ssim_means(a: &[f64], b: &[f64], width: usize) -> SsimMeans {
    let height = a.len() / width;
    let filtered = horizontal_moments(a, b, width);
    let window = gaussian_window();
    let (mut total, mut valid, mut contrast_structure) = (0.0, 0.0, 0.0);
    let mut row = vec![Moments::default(); width];
    for y in 0..height {
        // Vertical half of the window means; rows beyond the border are zero and need no term.
        row.fill(Moments::default());
        for source in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
            add_scaled(&mut row, &filtered[source * width..][..width], window[source + RADIUS - y]);
        }
        let row_is_valid = y >= RADIUS && y + RADIUS < height;
        for (x, &moments) in row.iter().enumerate() {
            let (ssim, cs) = ssim_of_window(moments);
            total += ssim;
            if row_is_valid && x >= RADIUS && x + RADIUS < width {
                valid += ssim;
                contrast_structure += cs;
            }
        }
    }
    let n_valid = (width + 1).saturating_sub(TAPS) * (height + 1).saturating_sub(TAPS);
    let mean_valid = |sum: f64| (n_valid > 0).then(|| sum / n_valid as f64);
    SsimMeans {
        zero_padded: total / (width * height) as f64,
        valid: mean_valid(valid),
        contrast_structure_valid: mean_valid(contrast_structure),
    }
}

/// SSIM of a window, and its contrast-structure factor.
fn ssim_of_window([mean_a, mean_b, mean_squares, mean_product]: Moments) -> (f64, f64) {
    let luminance_product = mean_a * mean_b;
    let luminance_squares = mean_a * mean_a + mean_b * mean_b;
    let covariance = mean_product - luminance_product;
    let variances = mean_squares - luminance_squares;
    let contrast_structure = (2.0 * covariance + C2) / (variances + C2);
    ((2.0 * luminance_product + C1) / (luminance_squares + C1) * contrast_structure, contrast_structure)
}

/// The SSIM of a window from its means, variances and covariance.
pub(super) fn index([a, b]: [f64; 2], [variance_a, variance_b]: [f64; 2], covariance: f64) -> f64 {
    let luminance = (2.0 * a * b + C1) / (a * a + b * b + C1);
    luminance * (2.0 * covariance + C2) / (variance_a + variance_b + C2)
}

/// The horizontal half of the window means, padded with zeros beyond the border.
fn horizontal_moments(a: &[f64], b: &[f64], width: usize) -> Vec<Moments> {
    let window = gaussian_window();
    let mut filtered = vec![Moments::default(); a.len()];
    let mut padded = vec![Moments::default(); width + 2 * RADIUS];
    for (start, row) in filtered.chunks_exact_mut(width).enumerate().map(|(y, row)| (y * width, row)) {
        for ((slot, &a), &b) in padded[RADIUS..].iter_mut().zip(&a[start..start + width]).zip(&b[start..]) {
            *slot = [a, b, a * a + b * b, a * b];
        }
        for (tap, &weight) in window.iter().enumerate() {
            add_scaled(row, &padded[tap..tap + width], weight);
        }
    }
    filtered
}

/// Adds `weight * row` to `sum`.
fn add_scaled(sum: &mut [Moments], row: &[Moments], weight: f64) {
    for (sum, moments) in sum.iter_mut().zip(row) {
        for (sum, moment) in sum.iter_mut().zip(moments) {
            *sum += weight * moment;
        }
    }
}

/// The Gaussian taps, normalised to sum 1.
pub(super) fn gaussian_window() -> [f64; TAPS] {
    let taps: [f64; TAPS] =
        std::array::from_fn(|tap| (-(tap as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| tap / sum)
}
