//! Images that need no model: one colour, and the mean of the other images. Renders that are not better are degenerate.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::metric::Metric;
use super::psnr::PSNR_CAP_DB;
use crate::image_file::Image;
use crate::masks::MaskName;

/// PSNR of images that need no model, against the ground truth of an evaluation. Means are over the images, as for
/// [`Metric::Psnr`](crate::Metric::Psnr).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trivial {
    /// The colour with the least squared error over all ground-truth images, i.e. their mean colour, in [0, 1].
    pub colour: [f64; 3],
    /// PSNR of constant images of that colour, dB.
    pub constant_psnr: f64,
    /// PSNR of mean images; none for a single image.
    pub mean_image: Option<MeanImage>,
    /// Share of the ground truth's pixels that have the capture's background colour; none without a capture.
    pub background_share: Option<f64>,
    /// Scores of renders without motion in the metrics of motion, over the images that define these; empty without
    /// exact maps.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub without_motion: BTreeMap<Metric, f64>,
    /// PSNR of the mean images on moving and on emerging surfaces, over the images that define them; empty without maps of
    /// velocity.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub moving_mean_image: BTreeMap<Metric, f64>,
    /// Masked metrics of the mean images by mask, over the images that define these; empty without masks.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub masked_mean_image: BTreeMap<MaskName, BTreeMap<Metric, f64>>,
    /// The least variance of a render over its pixels, mean over the channels, for colours in [0, 1].
    pub least_render_variance: f64,
}

/// The PSNR of showing, for every image, the per-pixel mean of others: an image is left out of its own mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanImage {
    /// PSNR in dB.
    pub psnr: f64,
    /// The images that a mean is taken over.
    pub over: MeanOver,
}

/// The images that a mean image is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeanOver {
    /// Images of the same camera pose, from which training images exist, too: the temporal mean image.
    TrainingPose,
    /// Images of the same camera pose, from which no training image exists. The mean shows a viewpoint that the model
    /// has never seen.
    HeldOutPose,
    /// All evaluated images, because some pose occurs only once.
    AllImages,
}

/// Why renders are degenerate, i.e. show no more than an image that needs no model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Degenerate {
    /// Every render has a single colour.
    NoVariance,
    /// The PSNR is not above that of the best constant image.
    NotAboveConstant,
    /// Something moves, the cameras of the evaluated images also have training images, and the PSNR is not above that
    /// of their temporal mean images.
    NotAboveMeanImage,
}

impl Degenerate {
    /// The reason in words.
    pub fn about(self) -> &'static str {
        match self {
            Self::NoVariance => "every render has a single colour",
            Self::NotAboveConstant => "the renders are not better than a constant image",
            Self::NotAboveMeanImage => "the renders are not better than the temporal mean image of their cameras",
        }
    }
}

impl Trivial {
    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        let optional = self.mean_image.map(|mean| mean.psnr).into_iter().chain(self.background_share);
        let by_metric = self
            .masked_mean_image
            .values()
            .chain([&self.without_motion, &self.moving_mean_image])
            .flat_map(BTreeMap::values);
        let required = [self.constant_psnr, self.least_render_variance].into_iter().chain(by_metric.copied());
        self.colour.into_iter().chain(required).chain(optional).all(f64::is_finite)
    }

    /// Whether the whole ground truth has one colour, so that no image is better than a constant one.
    pub fn truth_is_constant(&self) -> bool {
        self.constant_psnr >= PSNR_CAP_DB
    }

    /// Decides whether renders of this `psnr` are degenerate. `is_flat` states whether every render has one colour
    /// although the ground truth has not, `moves` whether their model can show motion.
    ///
    /// Nothing is degenerate where the ground truth has one colour. The mean image is used only if something moves and
    /// the model was trained from these viewpoints: at a held-out pose, good models of real captures may score below
    /// it.
    pub(crate) fn judge(&self, psnr: f64, is_flat: bool, moves: bool) -> Option<Degenerate> {
        if self.truth_is_constant() {
            return None;
        }
        if is_flat {
            return Some(Degenerate::NoVariance);
        }
        // Written so that NaN is degenerate.
        if !(psnr > self.constant_psnr) {
            return Some(Degenerate::NotAboveConstant);
        }
        let temporal = self.mean_image.filter(|mean| mean.over == MeanOver::TrainingPose && mean.psnr < PSNR_CAP_DB);
        let is_below = temporal.is_some_and(|mean| !(psnr > mean.psnr));
        (moves && is_below).then_some(Degenerate::NotAboveMeanImage)
    }
}

/// Mean and variance of an image over its pixels, per channel, for colours in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Moments {
    /// The mean colour.
    pub(crate) mean: [f64; 3],
    /// The variance.
    pub(crate) variance: [f64; 3],
}

impl Moments {
    pub(crate) fn of(image: &Image) -> Self {
        let count = (image.width * image.height) as f64;
        // Relative to a pixel, so that an image of one colour has that mean and no variance, without rounding errors.
        let mean =
            image.planes.each_ref().map(|plane| plane[0] + plane.iter().map(|v| v - plane[0]).sum::<f64>() / count);
        let variance = |c: usize| image.planes[c].iter().map(|v| (v - mean[c]) * (v - mean[c])).sum::<f64>() / count;
        Self { mean, variance: std::array::from_fn(variance) }
    }

    /// Mean squared error of a constant image of `colour`.
    pub(crate) fn mse_of_constant(&self, colour: [f64; 3]) -> f64 {
        (0..3).map(|c| self.variance[c] + (self.mean[c] - colour[c]).powi(2)).sum::<f64>() / 3.0
    }
}
