//! Peak signal-to-noise ratio.

use crate::image_file::Image;

/// The largest PSNR, which corresponds to a mean squared error of 1e-10.
///
/// Identical images have an infinite PSNR; the cap keeps means finite. EasyVolcap and 4K4D use the same floor of the error.
pub(crate) const PSNR_CAP_DB: f64 = 100.0;

/// The mean squared difference over pixels and channels, for colours in [0, 1]; the images must have equal sizes.
pub(crate) fn mean_squared_error(render: &Image, truth: &Image) -> f64 {
    let squared = |(a, b): (&f64, &f64)| (a - b) * (a - b);
    let plane_sum = |c: usize| render.planes[c].iter().zip(&truth.planes[c]).map(squared).sum::<f64>();
    (plane_sum(0) + plane_sum(1) + plane_sum(2)) / (3 * render.width * render.height) as f64
}

/// −10 log₁₀(mse) in dB for a peak of 1, at most [`PSNR_CAP_DB`]; NaN stays NaN.
pub(crate) fn psnr_from_mse(mse: f64) -> f64 {
    let psnr_db = -10.0 * mse.log10();
    // `min` would turn NaN into the best possible score.
    if psnr_db > PSNR_CAP_DB { PSNR_CAP_DB } else { psnr_db }
}
