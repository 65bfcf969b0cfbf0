//! Adds metrics of the masked part of each image.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{LabelMap, View};

use super::perceptual::Networks;
use crate::artifact::ImageMetrics;
use crate::image_file::Image;
use crate::lpips::{Backbone, InputRange};
use crate::masks::{Keep, Mask};
use crate::metrics::masked::{masked_mean, masked_psnr, masked_ssim};
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::params::MetricEvaluationParams;
use crate::test_set::TestSet;

/// The masks in use, if any masked metric is wanted.
pub(crate) fn wanted(params: &MetricEvaluationParams) -> impl Iterator<Item = Mask<'_>> {
    let is_wanted = params.metrics.iter().any(|metric| metric.is_masked());
    params.masks.used().filter(move |_| is_wanted)
}

/// Adds the metrics of one mask of the image at `index`; its folder, if the mask is in files and the folder exists.
pub(crate) fn add(
    image: &mut ImageMetrics,
    index: usize,
    set: &TestSet<'_>,
    (mask, folder): (Mask<'_>, Option<&Path>),
    networks: &Networks,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let (_, view) = set.views[index];
    let scores = match (mask.files, folder) {
        (Some(files), None) => {
            let reason = format!("no {} masks: {} is missing", mask.name.heading(), files.folder.display());
            Metric::ALL.into_iter().map(|metric| (metric, Score::undefined(&reason))).collect()
        }
        (Some(_), Some(folder)) => scores(index, set, &selected(read(folder, view)?, mask.keeps), networks, params)?,
        (None, _) => match set.capture.load_mask(view)? {
            Some(labels) => scores(index, set, &selected(labels, mask.keeps), networks, params)?,
            None => return Ok(()),
        },
    };
    let is_wanted = |metric: Metric| metric.is_masked() && params.metrics.contains(&metric);
    image.masked.insert(mask.name, scores.into_iter().filter(|(metric, _)| is_wanted(*metric)).collect());
    Ok(())
}

/// The pixels that a mask selects.
fn selected(map: LabelMap, keeps: Keep) -> Vec<bool> {
    map.labels.into_iter().map(|value| keeps.selects(value)).collect()
}

/// The masked metrics of the image at `index`.
fn scores(
    index: usize,
    set: &TestSet<'_>,
    mask: &[bool],
    networks: &Networks,
    params: &MetricEvaluationParams,
) -> anyhow::Result<Vec<(Metric, Score)>> {
    let [render, truth] = set.images(index, params)?;
    let mut scores = vec![(Metric::MaskedPsnr, masked_psnr(&render, &truth, mask))];
    if [Metric::MaskedSsim, Metric::MaskedSsimStrict].iter().any(|metric| params.metrics.contains(metric)) {
        let ssim = masked_ssim(&render, &truth, mask);
        scores.extend([(Metric::MaskedSsim, ssim.dycheck), (Metric::MaskedSsimStrict, ssim.strict)]);
    }
    if params.metrics.contains(&Metric::MaskedLpips) {
        scores.push((Metric::MaskedLpips, masked_lpips([render, truth], mask, networks)));
    }
    Ok(scores)
}

/// LPIPS per pixel of images that are black outside the mask, averaged over the mask.
fn masked_lpips(mut images: [Image; 2], mask: &[bool], networks: &Networks) -> Score {
    for plane in images.iter_mut().flat_map(|image| &mut image.planes) {
        plane.iter_mut().zip(mask).filter(|(_, kept)| !**kept).for_each(|(value, _)| *value = 0.0);
    }
    let mut mean = None;
    let score = networks.score(Backbone::Alex, |alex| {
        let distances = alex.distance_by_pixel([&images[0], &images[1]], InputRange::Signed)?;
        let score = masked_mean(mask, |at| distances[at]);
        let value = score.value();
        mean = Some(score);
        value
    });
    mean.unwrap_or(score)
}

/// Reads the mask file of a view, which must have the view's size: `NAME.png`, or `NAME.png.png` as in one benchmark.
fn read(folder: &Path, view: &View) -> Result<LabelMap, Failure> {
    let files = ["png", "png.png"].map(|extension| folder.join(format!("{}.{extension}", view.name)));
    let [path, _] = &files;
    let found: Option<&PathBuf> = files.iter().find(|path| path.is_file());
    let missing = || {
        let hint = "name the mask files like the capture's views, with the extension png";
        Failure::new(FailureKind::MissingData, format!("view {} has no mask", view.name)).hint(hint).at(path)
    };
    let path = found.ok_or_else(missing)?;
    let bad = |message: String| Failure::new(FailureKind::BadInput, message).at(path);
    let map = LabelMap::read(path).map_err(|error| bad(error.message))?;
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    if (map.width, map.height) == (width, height) {
        return Ok(map);
    }
    Err(bad(format!("the mask is {}×{} px instead of {width}×{height}", map.width, map.height))
        .hint("provide masks of this size: resizing would move their edges"))
}
