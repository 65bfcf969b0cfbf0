//! Pixel operations of the import: compositing, undistortion, and labels from masks.

use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageReader};
use scene::float_image::FloatImage;
use scene::mask_file::{MaskFile, MaskValues};
use scene::{Intrinsics, LabelMap, image_file};

use crate::error::{Result, bad};
use crate::files::image_size;
use crate::lens::{Lens, plane_point};

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

/// Decodes a mask.
pub(crate) fn read_mask(path: &Path) -> Result<MaskFile> {
    MaskFile::read(path)
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

/// The mapping from the values of mask files to labels, shared by a whole capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Labels {
    table: Vec<u8>,
    /// Whether the table is for the levels of files, and not for their labels.
    is_of_levels: bool,
    /// Names of the labels 1, 2, …; none if all masks are empty.
    pub(crate) class_names: Vec<String>,
}

impl Labels {
    /// Builds the mapping from all values that occur. Every non-zero value is an instance, numbered in order. Masks with
    /// blurred edges mark one object.
    pub(crate) fn of_values(values: &MaskValues) -> Self {
        if values.is_blurred() {
            return Self::of_one_object(values, |level| level >= values.least_level());
        }
        let instances: Vec<u8> = values.labels.iter().copied().filter(|value| *value > 0).collect();
        let mut table = vec![0; 256];
        instances.iter().zip(1..=u8::MAX).for_each(|(value, label)| table[usize::from(*value)] = label);
        let class_names = match instances.len() {
            1 => vec!["object".into()],
            count => (1..=count).map(|label| format!("object {label}")).collect(),
        };
        Self { table, is_of_levels: false, class_names }
    }

    /// The mapping for masks that are set on the background and 0 on what moves, from all values that occur.
    pub(crate) fn of_static_values(values: &MaskValues) -> Self {
        Self::of_one_object(values, |level| level < values.least_level())
    }

    fn of_one_object(values: &MaskValues, is_inside: impl Fn(u8) -> bool) -> Self {
        let table = (0..=255).map(|level| u8::from(is_inside(level))).collect();
        let is_empty = !values.levels.iter().any(|level| is_inside(*level));
        Self { table, is_of_levels: true, class_names: if is_empty { Vec::new() } else { vec!["object".into()] } }
    }

    /// Resamples the labels of one file to the pinhole `target` at `size`, by nearest pixel because labels cannot be mixed.
    pub(crate) fn read(&self, path: &Path, lens: &Lens, target: &Intrinsics, size: (u32, u32)) -> Result<LabelMap> {
        let MaskFile { levels, labels, .. } = read_mask(path)?;
        let mask = if self.is_of_levels { levels } else { labels };
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

/// The values in a mask file.
pub(crate) fn mask_values(path: &Path) -> Result<MaskValues> {
    let mut values = MaskValues::default();
    values.add(&read_mask(path)?);
    Ok(values)
}

/// Share of the pixels of masks that are set. Files that cannot be read are left out; the import reports them.
pub(crate) fn set_share<'p>(paths: impl Iterator<Item = &'p Path>) -> f64 {
    let files: Vec<MaskFile> = paths.filter_map(|path| read_mask(path).ok()).collect();
    let mut values = MaskValues::default();
    files.iter().for_each(|file| values.add(file));
    let least = values.least_level();
    let set: usize = files.iter().map(|file| file.levels.iter().filter(|level| **level >= least).count()).sum();
    set as f64 / files.iter().map(|file| file.levels.len()).sum::<usize>().max(1) as f64
}
