//! 8-bit images in PNG and JPEG files.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageReader};
pub use image::{GrayImage, Rgb, RgbImage, RgbaImage};

use crate::{Error, Result};

/// Pixels per row and rows, from the file's header alone.
pub fn read_size(path: &Path) -> Result<(u32, u32)> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let reader = reader.map_err(|error| Error::new(format!("cannot read the image ({error})")).at(path))?;
    reader.into_dimensions().map_err(|error| not_readable(&error, path))
}

/// An opaque colour image. A file with transparent pixels is refused: compositing is the caller's decision.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    let image = read(path)?;
    if image.color().has_alpha() && image.to_rgba8().pixels().any(|pixel| pixel[3] != 255) {
        let error = Error::new("image has transparent pixels where an opaque one is needed");
        return Err(error.hint("composite it on the declared background first").at(path));
    }
    Ok(image.into_rgb8())
}

/// A colour image with straight (not premultiplied) alpha; 255 everywhere where the file has none.
pub fn read_rgba(path: &Path) -> Result<RgbaImage> {
    Ok(read(path)?.into_rgba8())
}

/// An 8-bit image with one channel, its values as they are in the file.
pub fn read_grey(path: &Path) -> Result<GrayImage> {
    match read(path)? {
        DynamicImage::ImageLuma8(image) => Ok(image),
        other => Err(Error::new(format!("expected 8-bit grey, found {:?}", other.color())).at(path)),
    }
}

/// Writes a PNG with fixed settings, so that equal pixels give equal bytes.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<()> {
    write_file(path, &encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)?)
}

/// As [`write_rgb`], with straight alpha.
pub fn write_rgba(path: &Path, image: &RgbaImage) -> Result<()> {
    write_file(path, &encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgba8)?)
}

/// As [`write_rgb`], with one channel.
pub fn write_grey(path: &Path, image: &GrayImage) -> Result<()> {
    write_file(path, &encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::L8)?)
}

/// The bytes of a PNG file of an RGB image, as [`write_rgb`] writes them.
pub fn encode_rgb(image: &RgbImage) -> Result<Vec<u8>> {
    encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)
}

/// Writes a whole file, blaming its path.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(|error| Error::new("cannot write the file").at(path).because_of(error))
}

/// Reads a whole file, blaming its path.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| Error::new(format!("cannot read the file ({error})")).at(path))
}

/// Decodes a PNG or JPEG, recognised by its content and not by its name.
fn read(path: &Path) -> Result<DynamicImage> {
    let reader = ImageReader::new(Cursor::new(read_file(path)?)).with_guessed_format();
    let reader = reader.map_err(|error| Error::new(format!("cannot read the image ({error})")).at(path))?;
    reader.decode().map_err(|error| not_readable(&error, path))
}

/// Fast compression: files twice as small cost ten times the time and nobody keeps them for long.
fn encode_png(pixels: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .map_err(|error| Error::new(format!("cannot encode a PNG of {width}×{height} pixels ({error})")))?;
    Ok(bytes)
}

fn not_readable(error: &image::ImageError, path: &Path) -> Error {
    Error::new(format!("not a readable PNG or JPEG image ({error})")).hint("the file may be damaged").at(path)
}
