//! LPIPS (Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric", CVPR 2018), version 0.1.
//!
//! Both images pass through a classifier. At each of its taps, features are scaled to unit length per pixel, and their
//! squared differences are summed with weights that were fitted to human judgements. The distance is the sum over taps of
//! the mean over pixels: 0 for equal images, larger is worse. The weights are not part of this project: they are read from
//! the files that their authors publish ([`weights`]).

mod layers;
mod network;
mod pickle;
mod torch_file;
pub(crate) mod weights;

#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;

pub(crate) use self::network::Backbone;

use self::layers::Activation;
use self::network::{Network, tensor};
use self::torch_file::Tensor;
use crate::image_file::Image;

/// Mean of ImageNet's colours in [-1, 1], which is subtracted.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Standard deviation of ImageNet's colours in [-1, 1], by which the difference is divided.
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Added to feature lengths, so that features of length 0 stay 0.
const MIN_LENGTH: f64 = 1e-10;

/// The range that colours v in [0, 1] are mapped to before they enter the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InputRange {
    /// 2v − 1, as in the training of the networks and weights.
    Signed,
    /// v, as in the code of 3D Gaussian Splatting and 4DGaussians; it gives smaller distances.
    Unsigned,
}

/// A classifier with the weights of its features.
pub(crate) struct Lpips {
    backbone: Backbone,
    network: Network,
    /// One weight per channel, for each tap.
    heads: Vec<Vec<f32>>,
}

/// The weighted squared distance per feature pixel of one tap.
struct DistanceMap {
    height: usize,
    width: usize,
    values: Vec<f64>,
}

impl Lpips {
    /// Builds the metric from the tensors of a classifier and of LPIPS's heads (`linN.model.1.weight`).
    ///
    /// # Errors
    /// The name of a tensor that is missing, has another shape, or is not finite.
    pub(crate) fn new(
        backbone: Backbone,
        body: &BTreeMap<String, Tensor>,
        heads: &BTreeMap<String, Tensor>,
    ) -> Result<Self, String> {
        let head = |(tap, channels): (usize, usize)| {
            let name = format!("lin{tap}.model.1.weight");
            tensor(heads, &name, &[1, channels, 1, 1]).map(<[f32]>::to_vec)
        };
        let heads = backbone.tap_channels().into_iter().enumerate().map(head).collect::<Result<_, _>>()?;
        Ok(Self { backbone, network: Network::new(backbone, body)?, heads })
    }

    /// The distance of two images of equal size; `None` if they are too small for the network.
    pub(crate) fn distance(&self, images: [&Image; 2], range: InputRange) -> Option<f64> {
        let maps = self.maps(images, range)?;
        Some(maps.iter().map(|map| map.values.iter().sum::<f64>() / map.values.len() as f64).sum())
    }

    /// The distance per pixel [H, W]: the sum of the maps of all taps, upsampled bilinearly (pixel centres at ½).
    pub(crate) fn distance_by_pixel(&self, images: [&Image; 2], range: InputRange) -> Option<Vec<f64>> {
        let (width, height) = (images[0].width, images[0].height);
        let mut total = vec![0.0; width * height];
        for map in self.maps(images, range)? {
            let enlarged = map.enlarged(width, height);
            total.iter_mut().zip(enlarged).for_each(|(total, value)| *total += value);
        }
        Some(total)
    }

    fn maps(&self, images: [&Image; 2], range: InputRange) -> Option<Vec<DistanceMap>> {
        if !self.backbone.fits(images[0].width, images[0].height) {
            return None;
        }
        let mut heads = self.heads.iter();
        let mut maps = Vec::with_capacity(self.heads.len());
        self.network.compare(images.map(|image| input(image, range)), |pair| {
            maps.extend(heads.next().map(|head| DistanceMap::new(pair, head)));
        });
        Some(maps)
    }
}

/// Normalises an image for the network.
fn input(image: &Image, range: InputRange) -> Activation {
    let (gain, offset) = match range {
        InputRange::Signed => (2.0, -1.0),
        InputRange::Unsigned => (1.0, 0.0),
    };
    let value = |at: usize| {
        let (pixel, channel) = (at / 3, at % 3);
        ((gain * image.planes[channel][pixel] + offset) as f32 - SHIFT[channel]) / SCALE[channel]
    };
    let (width, height) = (image.width, image.height);
    Activation { height, width, channels: 3, values: (0..3 * width * height).map(value).collect() }
}

impl DistanceMap {
    fn new([a, b]: &[Activation; 2], head: &[f32]) -> Self {
        let length = |x: &[f32]| x.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt() + MIN_LENGTH;
        let distance = |(a, b): (&[f32], &[f32])| {
            let [over_a, over_b] = [a, b].map(|x| 1.0 / length(x));
            let squared = |((a, b), weight): ((&f32, &f32), &f32)| {
                f64::from(*weight) * (f64::from(*a) * over_a - f64::from(*b) * over_b).powi(2)
            };
            a.iter().zip(b).zip(head).map(squared).sum()
        };
        let pixels = a.values.chunks_exact(a.channels).zip(b.values.chunks_exact(b.channels));
        Self { height: a.height, width: a.width, values: pixels.map(distance).collect() }
    }

    /// Upsamples to [height, width], row-major; beyond the outermost pixel centres values are repeated.
    fn enlarged(&self, width: usize, height: usize) -> Vec<f64> {
        let (columns, rows) = (neighbours(self.width, width), neighbours(self.height, height));
        let mut out = Vec::with_capacity(width * height);
        for &(top, bottom, down) in &rows {
            let row = |row: usize| &self.values[row * self.width..][..self.width];
            let (top, bottom) = (row(top), row(bottom));
            out.extend(columns.iter().map(|&(left, right, across)| {
                let along = |row: &[f64]| row[left] * (1.0 - across) + row[right] * across;
                along(top) * (1.0 - down) + along(bottom) * down
            }));
        }
        out
    }
}

/// For each of `new` samples, the two neighbouring samples of `old`, and the interpolation weight of the second.
fn neighbours(old: usize, new: usize) -> Vec<(usize, usize, f64)> {
    let between = |at: usize| {
        let place = ((at as f64 + 0.5) * old as f64 / new as f64 - 0.5).max(0.0);
        let first = place.floor();
        (first as usize, (first as usize + 1).min(old - 1), place - first)
    };
    (0..new).map(between).collect()
}
