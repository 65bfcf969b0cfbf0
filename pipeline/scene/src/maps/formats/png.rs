//! PNG files of 8- or 16-bit integers, and the flow encoding of KITTI (Geiger et al. 2013).

use std::path::Path;

use super::{Content, checked_size, damaged};
use crate::mask_file::MaskFile;
use crate::{Error, FloatImage, Result, image_file};
use image::DynamicImage;

/// Factor of KITTI's flow code: red and green store `64 · flow + 2^15`, blue is 1 where the flow is valid.
const KITTI_SCALE: f32 = 64.0;
/// Offset of KITTI's flow code.
const KITTI_OFFSET: f32 = 32768.0;

/// Decodes a file: depth as integers of 8 or 16 bits, masks as the levels of a [`MaskFile`], flow in pixels, normals scaled to
/// [0, 1].
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let not_read = |error| damaged("PNG file", error, path);
    if content == Content::Mask {
        let MaskFile { levels, .. } = MaskFile::read(path).map_err(not_read)?;
        let (width, height) = checked_size(levels.width().into(), levels.height().into(), path)?;
        let values = levels.iter().map(|value| f32::from(*value)).collect();
        return Ok(FloatImage { width, height, channels: 1, values });
    }
    let image = image_file::decode(path).map_err(not_read)?;
    let (width, height) = checked_size(image.width().into(), image.height().into(), path)?;
    let values = match (content, image) {
        (Content::Depth, DynamicImage::ImageLuma16(image)) => image.iter().map(|value| f32::from(*value)).collect(),
        (Content::Depth, DynamicImage::ImageLuma8(image)) => image.iter().map(|value| f32::from(*value)).collect(),
        (Content::Depth, DynamicImage::ImageRgb8(image)) if image.pixels().all(is_grey) => {
            image.pixels().map(|pixel| f32::from(pixel.0[0])).collect()
        }
        (Content::Flow, DynamicImage::ImageRgb16(image)) => image.pixels().flat_map(|pixel| kitti(pixel.0)).collect(),
        (Content::Normals, DynamicImage::ImageRgb16(image)) => {
            image.iter().map(|value| f32::from(*value) / 65535.0).collect()
        }
        (Content::Normals, DynamicImage::ImageRgb8(image)) => {
            image.iter().map(|value| f32::from(*value) / 255.0).collect()
        }
        (_, image) => {
            let expected = match content {
                Content::Depth => "8- or 16-bit grey (a colour map is only a preview)",
                Content::Flow => "16-bit RGB (red and green 64 · flow + 32768, blue 1 where valid)",
                Content::Normals | Content::Mask => "8- or 16-bit RGB",
            };
            return Err(Error::new(format!("{:?} where {expected} is expected", image.color())).at(path));
        }
    };
    Ok(FloatImage { width, height, channels: content.channels(), values })
}

/// Whether the channels are equal, because some estimators write grey images with three channels.
fn is_grey(pixel: &image::Rgb<u8>) -> bool {
    pixel.0[0] == pixel.0[1] && pixel.0[1] == pixel.0[2]
}

/// Decodes the flow of one KITTI pixel; NaN where it is not valid.
fn kitti([red, green, valid]: [u16; 3]) -> [f32; 2] {
    let flow = |code: u16| if valid == 0 { f32::NAN } else { (f32::from(code) - KITTI_OFFSET) / KITTI_SCALE };
    [flow(red), flow(green)]
}
