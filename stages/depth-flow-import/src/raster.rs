//! Maps of another size than their view.

use std::path::Path;

use scene::{Error, FloatImage, Intrinsics, Result};

/// The map with the view's size, and how much it grew in each direction. Each pixel takes the nearest value of the file:
/// a mean over an edge would belong to neither side. A map of another shape is refused.
pub fn fitted(image: FloatImage, view: &Intrinsics, path: &Path) -> Result<(FloatImage, [f32; 2])> {
    let (width, height) = (view.width, view.height);
    if (image.width, image.height) == (width, height) {
        return Ok((image, [1.0; 2]));
    }
    let scale = [width as f32 / image.width as f32, height as f32 / image.height as f32];
    // Sizes are rounded to whole pixels on both sides.
    let skew_px = (image.height as f32 * scale[0] - height as f32).abs();
    if !(skew_px <= scale[0].max(1.0)) {
        let message = format!("{}×{} pixels for a view of {width}×{height}", image.width, image.height);
        return Err(Error::new(message).hint("maps must show what the images show, uncropped").at(path));
    }
    let source = |target: u32, scale: f32, count: u32| (((target as f32 + 0.5) / scale) as u32).min(count - 1) as usize;
    let pixel = |x: u32, y: u32| {
        let at = source(y, scale[1], image.height) * image.width as usize + source(x, scale[0], image.width);
        &image.values[at * image.channels..][..image.channels]
    };
    let values = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y).iter().copied())).collect();
    Ok((FloatImage { width, height, channels: image.channels, values }, scale))
}

/// Positions of the centres of all pixels, row by row.
pub fn pixel_centers(width: u32, height: u32) -> impl Iterator<Item = glam::DVec2> {
    let center = |x: u32, y: u32| glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    (0..height).flat_map(move |y| (0..width).map(move |x| center(x, y)))
}
