//! Differences between two images in colours of rising lightness.

use anyhow::ensure;
use image::imageops::{self, FilterType};
use image::{ImageBuffer, Luma, Rgb, RgbImage};

/// From dark to light, evenly for the eye, in colour and in grey.
pub const ERROR_SCALE: colorous::Gradient = colorous::INFERNO;

/// The mean absolute difference over channels, of 1, that is drawn lightest; a quarter is far beyond what a fit leaves.
pub const FULL_ERROR: f64 = 0.25;

/// The mean absolute difference per pixel in colours, made smaller where it is wider than `width`.
///
/// # Errors
/// Images of different sizes.
pub fn colours(render: &RgbImage, truth: &RgbImage, width: u32) -> anyhow::Result<RgbImage> {
    ensure!(render.dimensions() == truth.dimensions(), "render and truth have different sizes");
    let mut errors = ImageBuffer::from_fn(render.width(), render.height(), |x, y| {
        let (Rgb(a), Rgb(b)) = (render.get_pixel(x, y), truth.get_pixel(x, y));
        let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        Luma([sum as f32 / (3.0 * 255.0)])
    });
    if render.width() > width {
        // Errors are averaged, not their colours.
        let height = (f64::from(render.height()) * f64::from(width) / f64::from(render.width())).round().max(1.0);
        errors = imageops::resize(&errors, width, height as u32, FilterType::Triangle);
    }
    Ok(RgbImage::from_fn(errors.width(), errors.height(), |x, y| {
        let Luma([error]) = errors.get_pixel(x, y);
        let colour = ERROR_SCALE.eval_continuous((f64::from(*error) / FULL_ERROR).clamp(0.0, 1.0));
        Rgb([colour.r, colour.g, colour.b])
    }))
}
