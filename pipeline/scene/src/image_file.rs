//! PNG, JPEG, WebP and TIFF files of 8-bit images; other depths are converted.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::error::{DecodingError, ImageFormatHint, UnsupportedError, UnsupportedErrorKind};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageError, ImageFormat, ImageReader, ImageResult};
pub use image::{GrayImage, Rgb, RgbImage, RgbaImage};

use crate::{Error, Result};

/// Reads width and height from the header of a file.
pub(crate) fn read_size(path: &Path) -> Result<(u32, u32)> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let reader = reader.map_err(|error| Error::new(format!("cannot read the image ({error})")).at(path))?;
    reader.into_dimensions().map_err(|error| not_readable(&error, path))
}

/// Reads an opaque colour image. Transparent pixels are an error, because compositing is up to the caller.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    let image = read(path)?;
    if image.color().has_alpha() && image.to_rgba8().pixels().any(|pixel| pixel[3] != 255) {
        let error = Error::new("the image has transparent pixels, but an opaque image is required");
        return Err(error.hint("composite it on the declared background first").at(path));
    }
    Ok(image.into_rgb8())
}

/// Reads an 8-bit image with one channel, without any conversion.
pub(crate) fn read_grey(path: &Path) -> Result<GrayImage> {
    match read(path)? {
        DynamicImage::ImageLuma8(image) => Ok(image),
        other => Err(Error::new(format!("expected 8-bit grey, found {:?}", other.color())).at(path)),
    }
}

/// Writes an RGB image as PNG. Fixed settings make equal pixels give equal bytes.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<()> {
    write_file(path, &encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)?)
}

/// Writes a one-channel image as PNG. Fixed settings make equal pixels give equal bytes.
pub(crate) fn write_grey(path: &Path, image: &GrayImage) -> Result<()> {
    write_file(path, &encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::L8)?)
}

/// Encodes an RGB image as the PNG file that [`write_rgb`] writes.
pub fn encode_rgb(image: &RgbImage) -> Result<Vec<u8>> {
    encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)
}

/// Writes a whole file; an error names the path.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(|error| Error::new("cannot write the file").at(path).because_of(error))
}

/// Reads a whole file; an error names the path.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| Error::new(format!("cannot read the file ({error})")).at(path))
}

/// Decodes a PNG, JPEG, WebP or TIFF file, recognised by its content and not by its name. A truncated JPEG is an error; its
/// decoder alone would fill the missing part with grey.
pub fn decode(path: &Path) -> ImageResult<DynamicImage> {
    let bytes = std::fs::read(path)?;
    let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format()?;
    if reader.format() == Some(ImageFormat::Jpeg) && !jpeg_is_complete(&bytes) {
        let why = "the file ends before the end of the image";
        return Err(ImageError::Decoding(DecodingError::new(ImageFormatHint::Exact(ImageFormat::Jpeg), why)));
    }
    match reader.format() {
        // The decoder for GIF exists because tests read films.
        Some(ImageFormat::Gif) => Err(unsupported(ImageFormat::Gif)),
        _ => reader.decode(),
    }
}

fn unsupported(format: ImageFormat) -> ImageError {
    let kind = UnsupportedErrorKind::Format(ImageFormatHint::Exact(format));
    ImageError::Unsupported(UnsupportedError::from_format_and_kind(ImageFormatHint::Exact(format), kind))
}

/// Whether an EOI marker follows the last scan. Walks the segments by their lengths and the entropy-coded data by its
/// markers (ITU-T T.81, annex B).
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    const EOI: u8 = 0xd9;
    const SOS: u8 = 0xda;
    let is_alone = |marker: u8| matches!(marker, 0x01 | 0xd0..=0xd8); // TEM, RST0 to RST7, SOI: no length follows
    let mut at = 0;
    let mut in_scan = false;
    while let Some([first, marker]) = bytes.get(at..at + 2) {
        match (*first, *marker) {
            (0xff, 0xff) => at += 1, // fill bytes may precede any marker
            (0xff, EOI) => return true,
            (0xff, 0x00) if in_scan => at += 2, // a data byte 0xff
            (0xff, marker) if is_alone(marker) => at += 2,
            (0xff, marker) => {
                let Some([high, low]) = bytes.get(at + 2..at + 4) else { return false };
                at += 2 + usize::from(u16::from_be_bytes([*high, *low]));
                in_scan = marker == SOS;
            }
            _ => at += 1, // entropy-coded data, or bytes between segments, which decoders skip
        }
    }
    false
}

/// Decodes a file; an error names the path.
fn read(path: &Path) -> Result<DynamicImage> {
    decode(path).map_err(|error| not_readable(&error, path))
}

/// Encodes a PNG file with fast compression: half the size would take ten times as long, and the files are short-lived.
fn encode_png(pixels: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .map_err(|error| Error::new(format!("cannot encode a PNG of {width}×{height} pixels ({error})")))?;
    Ok(bytes)
}

fn not_readable(error: &image::ImageError, path: &Path) -> Error {
    Error::new(format!("not a readable PNG, JPEG, WebP or TIFF image ({error})"))
        .hint("the file may be damaged")
        .at(path)
}
