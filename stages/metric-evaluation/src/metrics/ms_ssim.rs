//! Multi-scale structural similarity (Wang, Simoncelli and Bovik, Asilomar 2003) as `pytorch_msssim` computes it.

use std::borrow::Cow;

use super::score::Score;
use super::ssim::{SsimMeans, TAPS, ssim_means};
use crate::image_file::Image;

/// Exponents of the five scales, beginning with the finest.
const SCALE_WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Minimum side in pixels: one window must fit at the coarsest scale, 1/16 of the size, i.e. (11 − 1)·16 + 1.
const MIN_SIZE: usize = (TAPS - 1) * 16 + 1;

/// MS-SSIM of a pair, given its SSIM means per channel at full resolution.
///
/// The windows are inside the image. The product over scales takes contrast-structure on scales 1 to 4 and SSIM on scale 5,
/// with negative means clamped to 0; it is averaged over channels. Downsampling averages 2×2 pixels, after padding an odd
/// side with zeros on both ends.
pub(super) fn ms_ssim(render: &Image, truth: &Image, full_scale: &[SsimMeans; 3]) -> Score {
    if render.width.min(render.height) < MIN_SIZE {
        return Score::undefined(format!("image smaller than {MIN_SIZE} px"));
    }
    let mut product_sum = 0.0;
    for (c, &finest) in full_scale.iter().enumerate() {
        let (mut a, mut b) = (Cow::from(&render.planes[c]), Cow::from(&truth.planes[c]));
        let (mut width, mut means, mut product) = (render.width, finest, 1.0);
        for (scale, weight) in SCALE_WEIGHTS.iter().enumerate() {
            if scale > 0 {
                (a, b) = (halved(&a, width).into(), halved(&b, width).into());
                width = width.div_ceil(2);
                means = ssim_means(&a, &b, width);
            }
            let factor = if scale == 4 { means.valid } else { means.contrast_structure_valid };
            product *= factor.unwrap_or(0.0).max(0.0).powf(*weight);
        }
        product_sum += product;
    }
    Score::Value(product_sum / 3.0)
}

/// Averages 2×2 pixels. An odd side n is padded with one zero on both ends, so that it becomes ⌈n / 2⌉.
fn halved(plane: &[f64], width: usize) -> Vec<f64> {
    let height = plane.len() / width;
    let (pad_x, pad_y) = (width % 2, height % 2);
    let pixel = |x: usize, y: usize| {
        let (x, y) = (x.wrapping_sub(pad_x), y.wrapping_sub(pad_y));
        if x < width && y < height { plane[y * width + x] } else { 0.0 }
    };
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let mean = |i: usize| {
        let (x, y) = (2 * (i % half_width), 2 * (i / half_width));
        (pixel(x, y) + pixel(x + 1, y) + pixel(x, y + 1) + pixel(x + 1, y + 1)) / 4.0
    };
    (0..half_width * half_height).map(mean).collect()
}
