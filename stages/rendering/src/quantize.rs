//! Rendered colours as 8-bit images.

use image::RgbImage;
use shaders::tape::Tensor;

/// Converts colours [H, W, 3] to 8 bits: clamped to [0, 1], rounded half up.
pub(crate) fn to_image(color: &Tensor<f32>) -> RgbImage {
    let &[height, width, 3] = color.shape() else { unreachable!("colours have shape [H, W, 3]") };
    let bytes = training::to_bytes(color);
    RgbImage::from_raw(width as u32, height as u32, bytes).expect("as many bytes as the shape says")
}
