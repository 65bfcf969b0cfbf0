//! Adds the errors of images that need no model.

use std::path::PathBuf;

use engine::Failure;
use rayon::prelude::*;
use scene::{Camera, Split};

use crate::artifact::ImageMetrics;
use crate::image_file::{Background, Image, Quantise};
use crate::metrics::metric::Metric;
use crate::metrics::psnr::mean_squared_error;
use crate::metrics::surfaces::psnr_of_moving;
use crate::metrics::trivial::MeanOver;
use crate::scoring::masked::Masked;
use crate::scoring::surfaces;
use crate::test_set::TestSet;

/// Levels of a colour in the sums of mean images: exact for files of 8 and of 16 bits per channel.
const LEVELS: f64 = 65535.0;

/// The largest difference from the background, per channel, of a pixel that counts as background: one of 255 levels and
/// the rounding of resized images.
const BACKGROUND_MARGIN: f64 = 1.5 / 255.0;

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

/// Adds to each image the error of the mean of the other images, also in masked metrics and on moving surfaces, and the
/// share of background pixels of its truth.
pub(crate) fn add(images: &mut [ImageMetrics], truths: &Truths, masked: Option<&Masked<'_>>) -> anyhow::Result<()> {
    for group in &truths.groups {
        let sums = sum_of_levels(group, truths)?;
        let measured = |&index: &usize| -> Result<_, Failure> {
            let truth = truths.read(index)?;
            let mse = mean_of_others(&truth, &sums, group.len()).map(|mean| mean_squared_error(&mean, &truth));
            Ok((index, mse, share_of(truths.background, &truth)))
        };
        for (index, mse, share) in group.par_iter().map(measured).collect::<Result<Vec<_>, Failure>>()? {
            (images[index].mean_image_mse, images[index].background_share) = (mse, share);
        }
        let Some(masked) = masked else { continue };
        // One image after another, because the networks of masked metrics use all threads.
        for &index in group {
            let moving = moving(masked, index)?;
            if moving.is_none() && !masked.is_wanted() {
                continue;
            }
            let truth = truths.read(index)?;
            let Some(mean) = mean_of_others(&truth, &sums, group.len()) else { continue };
            images[index].moving_mean_image = moving.and_then(|moving| psnr_of_moving(&mean, &truth, &moving).1);
            if masked.is_wanted() {
                images[index].masked_mean_image = masked.scores(index, &[mean, truth])?;
            }
        }
    }
    Ok(())
}

/// The pixels of an image whose true surface moves, if a metric of these is wanted and the capture has velocities.
fn moving(masked: &Masked<'_>, index: usize) -> anyhow::Result<Option<Vec<bool>>> {
    let Masked { set, params, .. } = masked;
    let is_wanted = [Metric::PsnrMoving, Metric::PsnrEmerging].iter().any(|metric| params.metrics.contains(metric));
    if is_wanted { surfaces::moving(set, index) } else { Ok(None) }
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

/// The mean of the other images of a group of `n_images` with these sums; none without others.
fn mean_of_others(truth: &Image, sums: &[Vec<u64>; 3], n_images: usize) -> Option<Image> {
    let n_others = n_images.checked_sub(1).filter(|others| *others > 0)? as f64;
    let others = |(value, sum): (&f64, &u64)| (sum - level(*value)) as f64 / LEVELS / n_others;
    let planes = std::array::from_fn(|c| truth.planes[c].iter().zip(&sums[c]).map(others).collect());
    Some(Image { planes, ..*truth })
}

/// The share of pixels that have the background's colour.
fn share_of(background: Option<[f64; 3]>, truth: &Image) -> Option<f64> {
    let colour = background?;
    let is_background = |at: &usize| (0..3).all(|c| (truth.planes[c][*at] - colour[c]).abs() <= BACKGROUND_MARGIN);
    let count = truth.width * truth.height;
    Some((0..count).filter(is_background).count() as f64 / count as f64)
}
