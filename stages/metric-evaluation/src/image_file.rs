//! Images in memory: reading, compositing and quantisation.

use std::path::Path;

use engine::{Failure, FailureKind};
use image::DynamicImage;
use serde::{Deserialize, Serialize};

/// An RGB image: three row-major planes (red, green, blue) of sRGB-encoded colours in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Image {
    /// Width in pixels.
    pub(crate) width: usize,
    /// Height in pixels.
    pub(crate) height: usize,
    /// One plane per channel, [H·W] each.
    pub(crate) planes: [Vec<f64>; 3],
}

/// The background for compositing transparent images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// White: every channel is 1.
    White,
    /// Black: every channel is 0.
    Black,
}

impl Image {
    /// Reads a PNG or JPEG of 8 or 16 bits per channel; a grey image gets three equal channels.
    ///
    /// Straight alpha is composited on `background`, then colours are quantised. Without a background, a transparent image
    /// is refused, because the background would decide the score.
    pub(crate) fn read(path: &Path, quantise: Quantise, background: Option<Background>) -> Result<Self, Failure> {
        let unreadable = |error: image::ImageError| {
            Failure::new(FailureKind::BadInput, format!("cannot read the image: {error}")).at(path)
        };
        let pixels = scene::image_file::decode(path).map_err(unreadable)?;
        if let DynamicImage::ImageRgb8(pixels) = &pixels {
            return Ok(Self::of_opaque(pixels, quantise));
        }
        let has_alpha = pixels.color().has_alpha();
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        let mut planes: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(width * height));
        for [red, green, blue, alpha] in straight_rgba(pixels) {
            let behind = match background {
                Some(Background::White) => 1.0,
                Some(Background::Black) => 0.0,
                None if has_alpha && alpha < 1.0 => {
                    return Err(Failure::new(FailureKind::BadInput, "the image is transparent")
                        .hint(
                            "composite it on the background (white or black) of the other images, e.g. with `pipeline eval \
                             --background white`",
                        )
                        .at(path));
                }
                None => 0.0,
            };
            for (plane, colour) in planes.iter_mut().zip([red, green, blue]) {
                plane.push(quantise.apply(colour * alpha + behind * (1.0 - alpha)));
            }
        }
        Ok(Self { width, height, planes })
    }

    /// An opaque image of 8 bits per channel.
    fn of_opaque(pixels: &image::RgbImage, quantise: Quantise) -> Self {
        let colours: [f64; 256] = std::array::from_fn(|level| quantise.apply(level as f64 / 255.0));
        let plane = |c: usize| pixels.pixels().map(|pixel| colours[usize::from(pixel.0[c])]).collect();
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        Self { width, height, planes: [plane(0), plane(1), plane(2)] }
    }

    /// Whether every pixel has the same colour.
    pub(crate) fn is_constant(&self) -> bool {
        self.planes.iter().all(|plane| plane.iter().all(|value| *value == plane[0]))
    }
}

/// Quantisation of colours before the comparison.
///
/// Papers on splatting evaluate the 8-bit files that they saved. The choice does not affect opaque 8-bit images; it affects
/// 16-bit images and composited transparency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quantise {
    /// Rounds to the nearest of 256 levels, halves up (`torchvision.utils.save_image`).
    #[default]
    Round8,
    /// Truncates to the next lower of 256 levels (an integer cast, as in 4DGaussians' compositing of the ground truth).
    Trunc8,
    /// Keeps the stored values.
    None,
}

impl Quantise {
    /// Quantises a colour in [0, 1].
    pub(crate) fn apply(self, colour: f64) -> f64 {
        // Truncation must not change a colour that is a whole level up to rounding error.
        const ROUNDING: f64 = 1e-9;
        match self {
            Self::Round8 => (colour * 255.0 + 0.5).floor() / 255.0,
            Self::Trunc8 => (colour * 255.0 + ROUNDING).floor() / 255.0,
            Self::None => colour,
        }
    }
}

/// Straight RGBA in [0, 1], from 8 or 16 bits per channel.
fn straight_rgba(pixels: DynamicImage) -> Box<dyn Iterator<Item = [f64; 4]>> {
    match pixels {
        DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_) => {
            let raw = pixels.into_rgba16().into_raw();
            Box::new((0..raw.len() / 4).map(move |i| std::array::from_fn(|c| f64::from(raw[4 * i + c]) / 65535.0)))
        }
        _ => {
            let raw = pixels.into_rgba8().into_raw();
            Box::new((0..raw.len() / 4).map(move |i| std::array::from_fn(|c| f64::from(raw[4 * i + c]) / 255.0)))
        }
    }
}
