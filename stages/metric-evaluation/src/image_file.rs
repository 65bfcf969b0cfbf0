//! Reading images to be judged.

use std::path::Path;

use engine::{Failure, FailureKind};
use image::DynamicImage;
use serde::{Deserialize, Serialize};

use crate::Quantise;

/// An RGB image: three planes (red, green, blue), row-major, sRGB-encoded colours in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// One plane per channel, `width * height` each.
    pub planes: [Vec<f64>; 3],
}

/// What transparent images are composited on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// Every channel 1.
    White,
    /// Every channel 0.
    Black,
}

impl Image {
    /// Reads a PNG or JPEG of 8 or 16 bits; grey images become three equal channels.
    ///
    /// Straight alpha is composited on `background` and rounded to 8 bits, unless `quantise` says otherwise; without a
    /// background a transparent image is refused, because what lies behind it decides the score.
    pub fn read(path: &Path, quantise: Quantise, background: Option<Background>) -> Result<Self, Failure> {
        let unreadable = |error: image::ImageError| {
            Failure::new(FailureKind::BadInput, format!("cannot read image: {error}")).at(path)
        };
        let pixels = scene::image_file::decode(path).map_err(unreadable)?;
        let has_alpha = pixels.color().has_alpha();
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        let mut planes: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(width * height));
        for [red, green, blue, alpha] in straight_rgba(pixels) {
            let behind = match background {
                Some(Background::White) => 1.0,
                Some(Background::Black) => 0.0,
                None if has_alpha && alpha < 1.0 => {
                    return Err(Failure::new(FailureKind::BadInput, "image is transparent")
                        .hint("say what it lies on: background white or black, the one of the other images")
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

    /// Whether every pixel has the same colour.
    pub fn is_constant(&self) -> bool {
        self.planes.iter().all(|plane| plane.iter().all(|value| *value == plane[0]))
    }
}

/// Straight RGBA in [0, 1], from the 8 or 16 bits of the file.
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
