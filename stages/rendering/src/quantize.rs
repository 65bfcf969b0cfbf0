//! Rendered colours as 8-bit images.

use image::RgbImage;
use shaders::arrays::bytes::to_bytes;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Tensor;

/// Converts colours [H, W, 3] to 8 bits: clamped to [0, 1], rounded half up.
pub(crate) fn to_image(color: &Tensor<f32>) -> RgbImage {
    let &[height, width, 3] = color.shape() else { unreachable!("colours have shape [H, W, 3]") };
    image([width, height], to_bytes(color).values)
}

/// The image of a camera with these bytes.
pub(crate) fn image_of(camera: &PinholeCamera, bytes: Vec<u8>) -> RgbImage {
    image([camera.width, camera.height], bytes)
}

fn image([width, height]: [usize; 2], bytes: Vec<u8>) -> RgbImage {
    RgbImage::from_raw(width as u32, height as u32, bytes).expect("three bytes per pixel")
}
