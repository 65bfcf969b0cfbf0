//! Pixel operations of the import: compositing, undistortion, and labels from masks.

use std::path::Path;

use image::{DynamicImage, GrayImage, ImageDecoder, ImageReader};
use scene::float_image::FloatImage;
use scene::{Intrinsics, LabelMap, image_file};

use crate::error::{Result, bad};
use crate::files::image_size;
use crate::lens::{Lens, plane_point};

/// Masks with more distinct non-zero values than this are assumed to have blurred edges.
const MAX_INSTANCES: usize = 16;

/// Whether an image file has an alpha channel, according to its header.
pub(crate) fn has_alpha(path: &Path) -> Result<bool> {
    image_size(path)?;
    let decoder = ImageReader::open(path).map_err(image::ImageError::from).and_then(|reader| {
        let reader = reader.with_guessed_format()?;
        reader.into_decoder()
    });
    let decoder = decoder.map_err(|error| bad(format!("image cannot be read ({error})")).at(path))?;
    Ok(decoder.color_type().has_alpha())
}

/// Decodes an image file.
pub(crate) fn decode(path: &Path) -> Result<DynamicImage> {
    image_file::decode(path)
        .map_err(|error| bad(format!("image cannot be read ({error})")).hint("the file may be damaged").at(path))
}

/// Decodes an image of labels, like [`image_file::decode_labels`].
pub(crate) fn decode_labels(path: &Path) -> Result<GrayImage> {
    image_file::decode_labels(path)
        .map_err(|error| bad(format!("mask cannot be read ({error})")).hint("the file may be damaged").at(path))
}

/// Composites an image on `background` at native size and rounds to 8 bits: round(rgb · a + background · (1 − a)).
/// Returns the colours, and the alpha channel if the image has one.
pub(crate) fn composited(image: DynamicImage, background: [f32; 3]) -> Result<(FloatImage, Option<FloatImage>)> {
    if !image.color().has_alpha() {
        return Ok((FloatImage::from_rgb(&image.into_rgb8()), None));
    }
    let rgba = image.into_rgba8();
    let rounded = FloatImage::composited(&rgba, background).to_rgb8().map_err(|error| bad(error.message))?;
    Ok((FloatImage::from_rgb(&rounded), Some(FloatImage::alpha_of(&rgba))))
}

/// Resamples an image bilinearly to the pinhole `target` of the same size. A lens without distortion leaves it unchanged.
pub(crate) fn undistorted(image: FloatImage, lens: &Lens, target: &Intrinsics) -> FloatImage {
    if lens.distortion.is_none() {
        return image;
    }
    let mut values = Vec::with_capacity(image.values.len());
    for row in 0..target.height {
        for column in 0..target.width {
            let pixel = lens.pixel(plane_point(target, column, row));
            append_bilinear(&image, pixel.x - 0.5, pixel.y - 0.5, &mut values);
        }
    }
    FloatImage { values, ..image }
}

/// Appends the interpolated value of every channel at (x, y), measured in pixels from the centre of the first pixel.
fn append_bilinear(image: &FloatImage, x: f64, y: f64, out: &mut Vec<f32>) {
    let axis = |value: f64, length: u32| {
        let last = length as usize - 1;
        let value = value.clamp(0.0, last as f64);
        let low = (value as usize).min(last.saturating_sub(1));
        (low, (low + 1).min(last), (value - low as f64) as f32)
    };
    let ((x0, x1, tx), (y0, y1, ty)) = (axis(x, image.width), axis(y, image.height));
    let at = |column: usize, row: usize| &image.values[(row * image.width as usize + column) * image.channels..];
    let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
    for channel in 0..image.channels {
        let top = a[channel] + tx * (b[channel] - a[channel]);
        let bottom = c[channel] + tx * (d[channel] - c[channel]);
        out.push(top + ty * (bottom - top));
    }
}

/// The mapping from grey values of mask files to labels, shared by a whole capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Labels {
    table: Vec<u8>,
    /// Names of the labels 1, 2, …
    pub(crate) class_names: Vec<String>,
}

impl Labels {
    /// Builds the mapping from all values that occur. Every non-zero value is an instance, numbered in order. Masks with
    /// blurred edges (more than [`MAX_INSTANCES`] values) are thresholded at one half.
    pub(crate) fn of_values(values: &[bool; 256]) -> Self {
        let instances: Vec<usize> = (1..256).filter(|&value| values[value]).collect();
        let mut table = vec![0; 256];
        if instances.len() > MAX_INSTANCES {
            table[128..].fill(1);
            return Self { table, class_names: vec!["object".into()] };
        }
        instances.iter().enumerate().for_each(|(rank, &value)| table[value] = rank as u8 + 1);
        let class_names = match instances.len() {
            1 => vec!["object".into()],
            count => (1..=count).map(|label| format!("object {label}")).collect(),
        };
        Self { table, class_names }
    }

    /// The mapping for masks that are 255 on the background and 0 on what moves, from all values that occur.
    pub(crate) fn of_static_values(mut values: [bool; 256]) -> Self {
        values.reverse();
        let mut labels = Self::of_values(&values);
        labels.table.reverse();
        labels
    }

    /// Resamples the labels of one file to the pinhole `target` at `size`, by nearest pixel because labels cannot be mixed.
    pub(crate) fn read(&self, path: &Path, lens: &Lens, target: &Intrinsics, size: (u32, u32)) -> Result<LabelMap> {
        let mask = decode_labels(path)?;
        let (width, height) = size;
        let scaled = Lens::pinhole(*target).resized(width, height).intrinsics;
        // A mask may have the size of the originals where the images are a smaller copy.
        let stored = lens.resized(mask.width(), mask.height());
        let mut labels = Vec::with_capacity((width * height) as usize);
        for row in 0..height {
            for column in 0..width {
                let pixel = stored.pixel(plane_point(&scaled, column, row));
                let clamped = |value: f64, length: u32| value.clamp(0.0, f64::from(length - 1)) as u32;
                let value = mask.get_pixel(clamped(pixel.x, mask.width()), clamped(pixel.y, mask.height()))[0];
                labels.push(self.table[usize::from(value)]);
            }
        }
        Ok(LabelMap { width, height, labels })
    }
}

/// The set of grey values in a mask file.
pub(crate) fn mask_values(path: &Path) -> Result<[bool; 256]> {
    let mut values = [false; 256];
    decode_labels(path)?.iter().for_each(|value| values[usize::from(*value)] = true);
    Ok(values)
}
