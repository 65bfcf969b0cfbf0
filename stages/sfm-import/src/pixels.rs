//! Pixels of one image on their way from its file into the capture: composite, undistort, resize, round.

use std::path::Path;

use image::{DynamicImage, GrayImage, ImageDecoder, ImageReader, RgbImage};
use scene::{Intrinsics, LabelMap};

use crate::lens::{Lens, plane_point};
use crate::params::Resize;
use crate::source::{Result, bad, image_size};

/// More distinct values than instances in one scene: the edges of such masks are blurred.
const MAX_INSTANCES: usize = 16;

/// [height, width, channels] values in 0..=255.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values per pixel.
    pub channels: usize,
    /// Row-major, channels innermost.
    pub values: Vec<f32>,
}

/// Whether an image file has an alpha channel, from its header.
pub fn has_alpha(path: &Path) -> Result<bool> {
    image_size(path)?;
    let decoder = ImageReader::open(path).map_err(image::ImageError::from).and_then(|reader| {
        let reader = reader.with_guessed_format()?;
        reader.into_decoder()
    });
    let decoder = decoder.map_err(|error| bad(format!("image cannot be read ({error})")).at(path))?;
    Ok(decoder.color_type().has_alpha())
}

fn decode(path: &Path) -> Result<DynamicImage> {
    let reader = ImageReader::open(path).map_err(image::ImageError::from);
    let image = reader.and_then(|reader| reader.with_guessed_format()?.decode());
    image.map_err(|error| bad(format!("image cannot be read ({error})")).hint("the file may be damaged").at(path))
}

/// The colours of a file, composited on `background` and rounded to 8 bits, and its alpha where it has some:
/// c = round(a · c + (1 − a) · background), once, in floating point, at native size.
pub fn composited(path: &Path, background: [f32; 3]) -> Result<(Raster, Option<Raster>)> {
    let image = decode(path)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let raster = |channels, values| Raster { width, height, channels, values };
    if !image.color().has_alpha() {
        return Ok((raster(3, image.into_rgb8().iter().map(|value| f32::from(*value)).collect()), None));
    }
    let rgba = image.into_rgba8();
    let mut color = Vec::with_capacity(3 * width * height);
    for pixel in rgba.pixels() {
        let alpha = f32::from(pixel[3]) / 255.0;
        let blend = |channel: usize| alpha * f32::from(pixel[channel]) + (1.0 - alpha) * 255.0 * background[channel];
        color.extend([0, 1, 2].map(|channel| (blend(channel) + 0.5).floor()));
    }
    let alpha = rgba.pixels().map(|pixel| f32::from(pixel[3])).collect();
    Ok((raster(3, color), Some(raster(1, alpha))))
}

impl Raster {
    /// The image that the pinhole `target` of the same size sees, looked up bilinearly; the raster itself for a lens
    /// without distortion.
    pub fn undistorted(self, lens: &Lens, target: &Intrinsics) -> Self {
        if lens.distortion.is_none() {
            return self;
        }
        let mut values = Vec::with_capacity(self.values.len());
        for row in 0..target.height {
            for column in 0..target.width {
                let pixel = lens.pixel(plane_point(target, column, row));
                self.bilinear(pixel.x - 0.5, pixel.y - 0.5, &mut values);
            }
        }
        Self { values, ..self }
    }

    /// Appends the value between pixel centres at (x, y) counted from the centre of the first pixel.
    fn bilinear(&self, x: f64, y: f64, out: &mut Vec<f32>) {
        let axis = |value: f64, length: usize| {
            let value = value.clamp(0.0, (length - 1) as f64);
            let low = (value as usize).min(length.saturating_sub(2));
            (low, (low + 1).min(length - 1), (value - low as f64) as f32)
        };
        let ((x0, x1, tx), (y0, y1, ty)) = (axis(x, self.width), axis(y, self.height));
        let at = |column: usize, row: usize| &self.values[(row * self.width + column) * self.channels..];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        for channel in 0..self.channels {
            let top = a[channel] + tx * (b[channel] - a[channel]);
            let bottom = c[channel] + tx * (d[channel] - c[channel]);
            out.push(top + ty * (bottom - top));
        }
    }

    /// The raster at another size: separable, with the filter widened by the reduction, so that nothing aliases.
    pub fn resized(self, width: usize, height: usize, filter: Resize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self;
        }
        let channels = self.channels;
        let columns = weights(self.width, width, filter);
        let mut narrow: Vec<f32> = Vec::with_capacity(self.height * width * channels);
        for row in self.values.chunks_exact(self.width * channels) {
            for (first, taps) in &columns {
                let mut sum = [0.0_f32; 4];
                for (pixel, weight) in row[first * channels..].chunks_exact(channels).zip(taps) {
                    pixel.iter().zip(&mut sum).for_each(|(value, sum)| *sum += weight * value);
                }
                narrow.extend(&sum[..channels]);
            }
        }
        let stride = width * channels;
        let mut values = vec![0.0; height * stride];
        for (row, (first, taps)) in values.chunks_exact_mut(stride).zip(weights(self.height, height, filter)) {
            for (source, weight) in narrow[first * stride..].chunks_exact(stride).zip(taps) {
                row.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        Self { width, height, channels, values }
    }

    /// Rounded half up and clamped.
    fn bytes(&self) -> Vec<u8> {
        self.values.iter().map(|value| (value + 0.5).floor().clamp(0.0, 255.0) as u8).collect()
    }

    /// As an 8-bit colour image.
    pub fn into_rgb(self) -> RgbImage {
        let image = RgbImage::from_raw(self.width as u32, self.height as u32, self.bytes());
        image.expect("a raster with three channels has three values per pixel")
    }

    /// As an 8-bit grey image.
    pub fn into_grey(self) -> GrayImage {
        let image = GrayImage::from_raw(self.width as u32, self.height as u32, self.bytes());
        image.expect("a raster with one channel has one value per pixel")
    }
}

/// For every output position the first input position and the weights from there on, which sum to 1.
///
/// Area: the share of the output pixel that each input pixel covers. Lanczos3: sinc(x) sinc(x / 3) for |x| < 3, with x
/// in output pixels when reducing.
fn weights(from: usize, to: usize, filter: Resize) -> Vec<(usize, Vec<f32>)> {
    let scale = from as f64 / to as f64;
    let tap = |output: usize, input: usize| match filter {
        Resize::Area => {
            let (start, end) = (output as f64 * scale, (output + 1) as f64 * scale);
            (end.min(input as f64 + 1.0) - start.max(input as f64)).max(0.0)
        }
        Resize::Lanczos3 => {
            let distance = (input as f64 + 0.5 - (output as f64 + 0.5) * scale) / scale.max(1.0);
            if distance.abs() < 3.0 { sinc(distance) * sinc(distance / 3.0) } else { 0.0 }
        }
    };
    let support = match filter {
        Resize::Area => 0.5 * scale,
        Resize::Lanczos3 => 3.0 * scale.max(1.0),
    };
    let taps = |output: usize| {
        let center = (output as f64 + 0.5) * scale;
        let first = (center - support).floor().max(0.0) as usize;
        let end = ((center + support).ceil() as usize).clamp(first + 1, from);
        let raw: Vec<f64> = (first..end).map(|input| tap(output, input)).collect();
        let sum: f64 = raw.iter().sum();
        (first, raw.iter().map(|weight| (weight / sum) as f32).collect())
    };
    (0..to).map(taps).collect()
}

fn sinc(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle == 0.0 { 1.0 } else { angle.sin() / angle }
}

/// How grey values of mask files become labels: one table for a whole capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Labels {
    table: Vec<u8>,
    /// Names of labels 1, 2, …
    pub class_names: Vec<String>,
}

impl Labels {
    /// From all values that occur: every non-zero value is an instance, numbered in order; blurred masks, which have
    /// more values than a scene has instances, are cut at one half.
    pub fn of_values(values: &[bool; 256]) -> Self {
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

    /// The labels of one file as the pinhole `target` sees them at `size`: nearest pixel, because labels do not mix.
    pub fn read(&self, path: &Path, lens: &Lens, target: &Intrinsics, size: (u32, u32)) -> Result<LabelMap> {
        let mask = decode(path)?.into_luma8();
        let (width, height) = size;
        let scaled = scene::Camera { intrinsics: *target, camera_from_world: scene::RigidTransform::IDENTITY }
            .resized(width, height)
            .intrinsics;
        let mut labels = Vec::with_capacity((width * height) as usize);
        for row in 0..height {
            for column in 0..width {
                let pixel = lens.pixel(plane_point(&scaled, column, row));
                let clamped = |value: f64, length: u32| value.clamp(0.0, f64::from(length - 1)) as u32;
                let value = mask.get_pixel(clamped(pixel.x, mask.width()), clamped(pixel.y, mask.height()))[0];
                labels.push(self.table[usize::from(value)]);
            }
        }
        Ok(LabelMap { width, height, labels })
    }
}

/// Which grey values a mask file has.
pub fn mask_values(path: &Path) -> Result<[bool; 256]> {
    let mut values = [false; 256];
    decode(path)?.into_luma8().iter().for_each(|value| values[usize::from(*value)] = true);
    Ok(values)
}
