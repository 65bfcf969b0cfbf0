//! Float images: compositing and resizing are computed in f32 and rounded to 8 bits once.

use crate::image_file::{GrayImage, RgbImage, RgbaImage};
use crate::{Error, Result};

/// An image of shape [H, W, C], row-major. Colours are sRGB-encoded in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct FloatImage {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Number of channels C.
    pub channels: usize,
    /// [H, W, C] values.
    pub values: Vec<f32>,
}

/// Reconstruction filter of a resize.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResizeFilter {
    /// Box filter: the mean over the area of a new pixel, with partly covered pixels weighted by their share.
    Area,
    /// Windowed sinc with three lobes, widened by the scale if the image shrinks (like LANCZOS in Pillow).
    Lanczos3,
}

/// Converts an sRGB-encoded intensity to 8 bits: clamped to [0, 1] and rounded half up. NaN becomes 0.
pub fn to_byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

impl FloatImage {
    /// Converts an opaque 8-bit image to [H, W, 3] values in [0, 1].
    pub fn from_rgb(image: &RgbImage) -> Self {
        let values = image.as_raw().iter().map(|value| f32::from(*value) / 255.0).collect();
        Self { width: image.width(), height: image.height(), channels: 3, values }
    }

    /// Composites straight alpha over a background colour, in encoded values: `rgb · a + background · (1 - a)`.
    pub fn composited(image: &RgbaImage, background: [f32; 3]) -> Self {
        let mut values = Vec::with_capacity(3 * image.width() as usize * image.height() as usize);
        for pixel in image.pixels() {
            let [rgb @ .., alpha] = pixel.0.map(|value| f32::from(value) / 255.0);
            values.extend(rgb.iter().zip(&background).map(|(color, behind)| color * alpha + behind * (1.0 - alpha)));
        }
        Self { width: image.width(), height: image.height(), channels: 3, values }
    }

    /// The alpha channel as an [H, W, 1] image.
    pub fn alpha_of(image: &RgbaImage) -> Self {
        let values = image.pixels().map(|pixel| f32::from(pixel[3]) / 255.0).collect();
        Self { width: image.width(), height: image.height(), channels: 1, values }
    }

    /// Resizes to `width` × `height` pixels; a copy if the size is unchanged. Lanczos may overshoot [0, 1].
    pub fn resized(&self, width: u32, height: u32, filter: ResizeFilter) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        self.resized_rows(height, filter).transposed().resized_rows(width, filter).transposed()
    }

    /// Converts a three-channel image to 8 bits, rounded half up.
    pub fn to_rgb8(&self) -> Result<RgbImage> {
        let bytes = self.values.iter().map(|value| to_byte(*value)).collect();
        let image = (self.channels == 3).then(|| RgbImage::from_raw(self.width, self.height, bytes)).flatten();
        image.ok_or_else(|| self.wrong_shape(3))
    }

    /// Converts a one-channel image to 8 bits, rounded half up.
    pub fn to_grey8(&self) -> Result<GrayImage> {
        let bytes = self.values.iter().map(|value| to_byte(*value)).collect();
        let image = (self.channels == 1).then(|| GrayImage::from_raw(self.width, self.height, bytes)).flatten();
        image.ok_or_else(|| self.wrong_shape(1))
    }

    /// Resamples to `height` rows: every new row is a weighted sum of old rows, accumulated in f64.
    fn resized_rows(&self, height: u32, filter: ResizeFilter) -> Self {
        let stride = self.width as usize * self.channels;
        let mut values = Vec::with_capacity(height as usize * stride);
        let mut row = vec![0.0_f64; stride];
        for target in 0..height {
            row.fill(0.0);
            let (first, weights) = filter.weights(target, height, self.height);
            for (source, weight) in (first..).zip(weights) {
                let old = &self.values[source * stride..][..stride];
                row.iter_mut().zip(old).for_each(|(sum, value)| *sum += weight * f64::from(*value));
            }
            values.extend(row.iter().map(|sum| *sum as f32));
        }
        Self { height, values, ..*self }
    }

    /// Swaps rows and columns.
    fn transposed(&self) -> Self {
        let (width, height, channels) = (self.width as usize, self.height as usize, self.channels);
        let mut values = Vec::with_capacity(self.values.len());
        for column in 0..width {
            for row in 0..height {
                values.extend_from_slice(&self.values[(row * width + column) * channels..][..channels]);
            }
        }
        Self { width: self.height, height: self.width, channels, values }
    }

    fn wrong_shape(&self, channels: usize) -> Error {
        let Self { width, height, channels: have, values } = self;
        Error::new(format!("{} values, {have} channels for an image of {width}×{height}×{channels}", values.len()))
    }
}

impl ResizeFilter {
    /// The first source sample and the weights (with sum 1) of sample `target` when `old` samples become `new` samples.
    fn weights(self, target: u32, new: u32, old: u32) -> (usize, Vec<f64>) {
        let scale = f64::from(old) / f64::from(new);
        let center = (f64::from(target) + 0.5) * scale;
        let stretch = scale.max(1.0);
        let radius = match self {
            Self::Area => 0.5 * scale,
            Self::Lanczos3 => 3.0 * stretch,
        };
        let first = (center - radius).floor().max(0.0) as usize;
        let last = ((center + radius).ceil() as usize).min(old as usize);
        let weight = |source: usize| match self {
            Self::Area => overlap([source as f64, (source + 1) as f64], [center - radius, center + radius]),
            Self::Lanczos3 => lanczos3((source as f64 + 0.5 - center) / stretch),
        };
        let weights: Vec<f64> = (first..last).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        (first, weights.into_iter().map(|weight| weight / sum).collect())
    }
}

/// The Lanczos kernel `sinc(x) · sinc(x / 3)` on (-3, 3); 0 elsewhere.
fn lanczos3(x: f64) -> f64 {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) };
    if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}

/// Length of the intersection of two intervals.
fn overlap(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[1].min(b[1]) - a[0].max(b[0])).max(0.0)
}

#[cfg(test)]
mod tests;
