//! PNG files: 8- or 16-bit integers as they are, and the flow encoding of KITTI (Geiger et al. 2013).

use std::path::Path;

use image::DynamicImage;
use scene::{Error, FloatImage, Result, image_file};

use super::{Content, checked_size, damaged};

/// KITTI stores `64 · flow + 2^15` as red and green, and validity as blue.
const KITTI_SCALE: f32 = 64.0;
/// See [`KITTI_SCALE`].
const KITTI_OFFSET: f32 = 32768.0;

/// Decodes a file: depth as integers of 16 bits, masks as grey levels of 8, flow in pixels, normals as shares of the largest value in [0, 1].
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let image = image_file::decode(path).map_err(|error| damaged("PNG file", error, path))?;
    let (width, height) = checked_size(image.width().into(), image.height().into(), path)?;
    let values = match (content, image) {
        (Content::Depth, DynamicImage::ImageLuma16(image)) => image.iter().map(|value| f32::from(*value)).collect(),
        (Content::Flow, DynamicImage::ImageRgb16(image)) => image.pixels().flat_map(|pixel| kitti(pixel.0)).collect(),
        (Content::Mask, image) => image.into_luma8().iter().map(|value| f32::from(*value)).collect(),
        (Content::Normals, DynamicImage::ImageRgb16(image)) => {
            image.iter().map(|value| share(*value, 65535.0)).collect()
        }
        (Content::Normals, DynamicImage::ImageRgb8(image)) => image.iter().map(|value| share(*value, 255.0)).collect(),
        (_, image) => {
            let expected = match content {
                Content::Depth => "16-bit grey (8-bit previews have lost the scale)",
                Content::Flow => "16-bit RGB (red and green 64 · flow + 32768, blue 1 where valid)",
                Content::Normals | Content::Mask => "8- or 16-bit RGB",
            };
            return Err(Error::new(format!("{:?} where {expected} is expected", image.color())).at(path));
        }
    };
    Ok(FloatImage { width, height, channels: content.channels(), values })
}

fn kitti([red, green, valid]: [u16; 3]) -> [f32; 2] {
    let flow = |code: u16| if valid == 0 { f32::NAN } else { (f32::from(code) - KITTI_OFFSET) / KITTI_SCALE };
    [flow(red), flow(green)]
}

fn share(value: impl Into<f32>, largest: f32) -> f32 {
    value.into() / largest
}
