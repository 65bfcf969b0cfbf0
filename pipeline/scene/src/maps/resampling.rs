//! Resampling of maps to the size of their view.

use std::path::Path;

use crate::{Error, FloatImage, Intrinsics, Result};

/// Side of the patches of vision transformers, to whose multiples some estimators stretch images (e.g. VGGT and Depth
/// Anything, whose encoder is DINOv2).
const PATCH_PX: u32 = 14;

/// Resamples a map to the size of a view and returns it with the horizontal and vertical scale factors.
///
/// Every pixel takes the nearest value of the file: a mean across an edge would belong to neither side. A map with
/// another aspect ratio is an error, unless both sides are multiples of `PATCH_PX` and rounding to them explains it.
pub fn fit_to_view(image: FloatImage, view: &Intrinsics, path: &Path) -> Result<(FloatImage, [f32; 2])> {
    let (width, height) = (view.width, view.height);
    if (image.width, image.height) == (width, height) {
        return Ok((image, [1.0; 2]));
    }
    let scale = [width as f32 / image.width as f32, height as f32 / image.height as f32];
    // Both sizes are rounded, to whole pixels or to whole patches.
    let is_patched = [image.width, image.height].iter().all(|side| side.is_multiple_of(PATCH_PX));
    let rounding_px = if is_patched { PATCH_PX as f32 / 2.0 } else { 1.0 };
    let skew_px = (image.height as f32 * scale[0] - height as f32).abs();
    if !(skew_px <= (scale[0] * rounding_px).max(1.0)) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_may_be_rounded_to_pixels_or_patches() {
        let fits = |[width, height]: [u32; 2], view: [u32; 2]| {
            let image = FloatImage { width, height, channels: 1, values: vec![1.0; (width * height) as usize] };
            let [width, height] = view;
            let view = Intrinsics { width, height, focal_x: 500.0, focal_y: 500.0, center_x: 0.0, center_y: 0.0 };
            fit_to_view(image, &view, Path::new("map.npy")).is_ok()
        };
        assert!(fits([960, 540], [1920, 1080]) && fits([683, 384], [1366, 768]), "whole pixels");
        assert!(fits([518, 294], [1920, 1080]) && fits([518, 392], [640, 480]), "stretched to multiples of 14");
        assert!(!fits([518, 518], [1080, 1920]), "a portrait image that was cropped");
        assert!(!fits([512, 294], [1920, 1080]), "no multiple of 14");
    }
}
