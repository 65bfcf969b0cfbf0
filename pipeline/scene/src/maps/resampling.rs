//! Resampling of maps to the size of their view.

use std::path::Path;

use crate::{Error, FloatImage, Intrinsics, Result};

/// Resamples a map to the size of a view and returns it with the horizontal and vertical scale factors.
///
/// Every pixel takes the nearest value of the file: a mean across an edge would belong to neither side. A map with
/// another aspect ratio is an error.
pub fn fit_to_view(image: FloatImage, view: &Intrinsics, path: &Path) -> Result<(FloatImage, [f32; 2])> {
    let (width, height) = (view.width, view.height);
    if (image.width, image.height) == (width, height) {
        return Ok((image, [1.0; 2]));
    }
    let scale = [width as f32 / image.width as f32, height as f32 / image.height as f32];
    // Both sizes are rounded to whole pixels.
    let skew_px = (image.height as f32 * scale[0] - height as f32).abs();
    if !(skew_px <= scale[0].max(1.0)) {
        let message = format!("{}×{} pixels for a view of {width}×{height}", image.width, image.height);
        return Err(Error::new(message).hint("maps must cover the whole image, uncropped").at(path));
    }
    let source = |target: u32, scale: f32, count: u32| (((target as f32 + 0.5) / scale) as u32).min(count - 1) as usize;
    let pixel = |x: u32, y: u32| {
        let at = source(y, scale[1], image.height) * image.width as usize + source(x, scale[0], image.width);
        &image.values[at * image.channels..][..image.channels]
    };
    let values = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y).iter().copied())).collect();
    Ok((FloatImage { width, height, channels: image.channels, values }, scale))
}
