//! Error maps: differences between two images in colours of increasing lightness.

use anyhow::ensure;
use image::imageops::{self, FilterType};
use image::{ImageBuffer, Luma, Rgb, RgbImage};

/// Colour scale of error maps: perceptually uniform, from dark to light, also in greyscale.
pub(crate) const ERROR_SCALE: colorous::Gradient = colorous::INFERNO;

/// The mean absolute difference over channels (of 1) at which the scale saturates; a fitted model stays far below it.
pub(crate) const FULL_ERROR: f64 = 0.25;

/// The error map of a render: mean absolute difference per pixel, scaled down to `width` if it is wider.
///
/// # Errors
/// Fails if the images differ in size.
pub(crate) fn colours(render: &RgbImage, truth: &RgbImage, width: u32) -> anyhow::Result<RgbImage> {
    ensure!(render.dimensions() == truth.dimensions(), "render and ground truth differ in size");
    let mut errors = ImageBuffer::from_fn(render.width(), render.height(), |x, y| {
        let (Rgb(a), Rgb(b)) = (render.get_pixel(x, y), truth.get_pixel(x, y));
        let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        Luma([sum as f32 / (3.0 * 255.0)])
    });
    if render.width() > width {
        // Average the errors, not their colours.
        let height = (f64::from(render.height()) * f64::from(width) / f64::from(render.width())).round().max(1.0);
        errors = imageops::resize(&errors, width, height as u32, FilterType::Triangle);
    }
    Ok(RgbImage::from_fn(errors.width(), errors.height(), |x, y| {
        let Luma([error]) = errors.get_pixel(x, y);
        let colour = ERROR_SCALE.eval_continuous((f64::from(*error) / FULL_ERROR).clamp(0.0, 1.0));
        Rgb([colour.r, colour.g, colour.b])
    }))
}
