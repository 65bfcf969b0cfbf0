//! Rendered colours as 8-bit images.

use image::RgbImage;
use shaders::arrays::bytes::{Bytes, to_bytes};
use shaders::tape::Tensor;

/// Converts colours [H, W, 3] to 8 bits: clamped to [0, 1], rounded half up.
pub(crate) fn to_image(color: &Tensor<f32>) -> RgbImage {
    image_of(color, to_bytes(color))
}

/// The image of colours [H, W, 3]; `None` if any is infinite or NaN.
pub(crate) fn to_finite_image(color: &Tensor<f32>) -> Option<RgbImage> {
    let bytes = to_bytes(color);
    bytes.are_finite.then(|| image_of(color, bytes))
}

fn image_of(color: &Tensor<f32>, bytes: Bytes) -> RgbImage {
    let &[height, width, 3] = color.shape() else { unreachable!("colours have shape [H, W, 3]") };
    RgbImage::from_raw(width as u32, height as u32, bytes.values).expect("as many bytes as the shape says")
}
