//! Images that need no model: one colour, and the mean of the other images. Renders that are not better show nothing.

use std::path::PathBuf;

use engine::Failure;
use rayon::prelude::*;
use scene::{Camera, Split};
use serde::{Deserialize, Serialize};

use crate::artifact::{ImageMetrics, Remark};
use crate::image_file::{Background, Image, Quantise};
use crate::metrics::psnr::{PSNR_CAP_DB, psnr_from_mse};
use crate::test_set::TestSet;

/// Levels of a colour in the sums of mean images: exact for files of 8 and of 16 bits per channel.
const LEVELS: f64 = 65535.0;

/// The largest difference from the background, per channel, of a pixel that counts as background: one of 255 levels and
/// the rounding of resized images.
const BACKGROUND_MARGIN: f64 = 1.5 / 255.0;

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
    /// Images of the same camera pose, from which no training image exists. The mean knows a viewpoint that no model was
    /// shown.
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
    /// Something moves, cameras of the evaluated images were trained on, and the PSNR is not above that of their
    /// temporal mean images.
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
    /// Summarises what the images carry about trivial images; `over` is what their mean images were taken over.
    pub(crate) fn of(images: &[ImageMetrics], over: MeanOver) -> Self {
        let count = images.len() as f64;
        let mean = |value: &dyn Fn(&ImageMetrics) -> f64| images.iter().map(value).sum::<f64>() / count;
        let colour = std::array::from_fn(|c| mean(&|image| image.truth.mean[c]));
        let mean_of = |value: fn(&ImageMetrics) -> Option<f64>| -> Option<f64> {
            images.iter().map(value).sum::<Option<f64>>().map(|sum| sum / count)
        };
        let mean_image_psnr = mean_of(|image| image.mean_image_mse.map(psnr_from_mse));
        Self {
            colour,
            constant_psnr: mean(&|image| psnr_from_mse(image.truth.mse_of_constant(colour))),
            mean_image: mean_image_psnr.map(|psnr| MeanImage { psnr, over }),
            background_share: mean_of(|image| image.background_share),
            least_render_variance: images.iter().map(|image| image.render_variance).fold(f64::INFINITY, f64::min),
        }
    }

    /// The images that the mean images were taken over; [`MeanOver::AllImages`] without mean images.
    pub(crate) fn over(&self) -> MeanOver {
        self.mean_image.map_or(MeanOver::AllImages, |mean| mean.over)
    }

    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        let optional = self.mean_image.map(|mean| mean.psnr).into_iter().chain(self.background_share);
        let required = [self.constant_psnr, self.least_render_variance];
        self.colour.into_iter().chain(required).chain(optional).all(f64::is_finite)
    }

    /// Whether the whole ground truth has one colour, so that no image is better than a constant one.
    pub fn truth_is_constant(&self) -> bool {
        self.constant_psnr >= PSNR_CAP_DB
    }

    /// Judges renders of this `psnr`; `moves` states whether their model can show motion.
    ///
    /// Nothing is degenerate where the ground truth has one colour. The mean image decides only where something moves and
    /// the model was shown the viewpoints: at a held-out pose, good models of real captures may lose to it.
    pub(crate) fn judge(&self, images: &[ImageMetrics], psnr: f64, moves: bool) -> Option<Degenerate> {
        if self.truth_is_constant() {
            return None;
        }
        let is_flat = |image: &ImageMetrics| image.remarks.contains(&Remark::ConstantRender);
        let has_flat_truth = |image: &ImageMetrics| image.remarks.contains(&Remark::ConstantTruth);
        if images.iter().all(is_flat) && !images.iter().all(has_flat_truth) {
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

/// The ground truth of an evaluation: files, and the groups of images that mean images are taken over.
pub(crate) struct Truths {
    /// Image files in the order of the evaluated images.
    pub(crate) paths: Vec<PathBuf>,
    /// The background that transparent files are composited on.
    pub(crate) behind: Option<Background>,
    /// Quantisation of colours.
    pub(crate) quantise: Quantise,
    /// The capture's background colour, if there is a capture.
    pub(crate) background: Option<[f64; 3]>,
    /// Indices of images with a common mean.
    groups: Vec<Vec<usize>>,
    /// What the groups are.
    pub(crate) over: MeanOver,
}

impl Truths {
    /// Ground truth without poses: one mean over all images.
    pub(crate) fn without_poses(paths: Vec<PathBuf>, quantise: Quantise, behind: Option<Background>) -> Self {
        let groups = vec![(0..paths.len()).collect()];
        Self { paths, behind, quantise, background: None, groups, over: MeanOver::AllImages }
    }

    /// The ground truth of a split. Mean images are per pose if every evaluated pose occurs at least twice.
    pub(crate) fn of_set(set: &TestSet<'_>, quantise: Quantise) -> Self {
        let mut by_pose: Vec<(&Camera, Vec<usize>)> = Vec::new();
        for (index, (_, view)) in set.views.iter().enumerate() {
            match by_pose.iter_mut().find(|(camera, _)| **camera == view.camera) {
                Some((_, group)) => group.push(index),
                None => by_pose.push((&view.camera, vec![index])),
            }
        }
        let paths = set.views.iter().map(|(_, view)| set.capture.dir.join(&view.image)).collect();
        let background = Some(set.capture.background.map(f64::from));
        let all = Self { background, ..Self::without_poses(paths, quantise, None) };
        if by_pose.iter().any(|(_, group)| group.len() < 2) {
            return all;
        }
        let is_trained =
            |(camera, _): &(&Camera, _)| set.capture.views_of(Split::Train).any(|(_, view)| view.camera == **camera);
        let over = if by_pose.iter().all(is_trained) { MeanOver::TrainingPose } else { MeanOver::HeldOutPose };
        Self { over, groups: by_pose.into_iter().map(|(_, group)| group).collect(), ..all }
    }

    fn read(&self, index: usize) -> Result<Image, Failure> {
        Image::read(&self.paths[index], self.quantise, self.behind)
    }
}

/// Adds to each image the error of the mean of the other images, and the share of background pixels of its truth.
pub(crate) fn add(images: &mut [ImageMetrics], truths: &Truths) -> Result<(), Failure> {
    for group in &truths.groups {
        let sums = sum_of_levels(group, truths)?;
        let measured = |&index: &usize| -> Result<_, Failure> {
            let truth = truths.read(index)?;
            Ok((index, mse_of_others(&truth, &sums, group.len()), share_of(truths.background, &truth)))
        };
        for (index, mse, share) in group.par_iter().map(measured).collect::<Result<Vec<_>, Failure>>()? {
            (images[index].mean_image_mse, images[index].background_share) = (mse, share);
        }
    }
    Ok(())
}

/// The sum of the images of a group, in [`LEVELS`]. Integers, so that it does not depend on the order of the threads.
fn sum_of_levels(group: &[usize], truths: &Truths) -> Result<[Vec<u64>; 3], Failure> {
    let add_image = |sums: [Vec<u64>; 3], index: &usize| -> Result<_, Failure> {
        let levels = truths.read(*index)?.planes.map(|plane| plane.into_iter().map(level).collect());
        Ok(added(sums, levels))
    };
    let empty = || [const { Vec::new() }; 3];
    group.par_iter().try_fold(empty, add_image).try_reduce(empty, |a, b| Ok(added(a, b)))
}

/// A colour in [`LEVELS`], rounded.
fn level(colour: f64) -> u64 {
    (colour * LEVELS + 0.5) as u64
}

/// The sum of two arrays, of which either may be empty.
fn added(a: [Vec<u64>; 3], b: [Vec<u64>; 3]) -> [Vec<u64>; 3] {
    if a[0].is_empty() {
        return b;
    }
    let mut sums = a;
    for (sum, other) in sums.iter_mut().zip(&b) {
        sum.iter_mut().zip(other).for_each(|(sum, value)| *sum += value);
    }
    sums
}

/// The mean squared error of the mean of the other images of a group; none without others.
fn mse_of_others(truth: &Image, sums: &[Vec<u64>; 3], n_images: usize) -> Option<f64> {
    let n_others = n_images.checked_sub(1).filter(|others| *others > 0)? as f64;
    let squared = |(value, sum): (&f64, &u64)| {
        let others = (sum - level(*value)) as f64 / LEVELS / n_others;
        (value - others) * (value - others)
    };
    let plane = |c: usize| truth.planes[c].iter().zip(&sums[c]).map(squared).sum::<f64>();
    Some((plane(0) + plane(1) + plane(2)) / (3 * truth.width * truth.height) as f64)
}

/// The share of pixels that have the background's colour.
fn share_of(background: Option<[f64; 3]>, truth: &Image) -> Option<f64> {
    let colour = background?;
    let is_background = |at: &usize| (0..3).all(|c| (truth.planes[c][*at] - colour[c]).abs() <= BACKGROUND_MARGIN);
    let count = truth.width * truth.height;
    Some((0..count).filter(is_background).count() as f64 / count as f64)
}
