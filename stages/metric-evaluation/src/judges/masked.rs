//! Adds the figures of the part of each image that a mask keeps.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{LabelMap, View};

use super::perceptual::Networks;
use crate::lpips::{Backbone, InputRange};
use crate::metrics::{Family, masked_mean, masked_psnr, masked_ssim};
use crate::params::{Keep, MaskSource};
use crate::test_set::TestSet;
use crate::{Image, ImageMetrics, Metric, MetricEvaluationParams, Score};

/// Whether there is anything to do.
pub fn is_wanted(params: &MetricEvaluationParams) -> bool {
    params.mask != MaskSource::None && params.metrics.iter().any(|metric| metric.family() == Family::Masked)
}

/// Judges the image at `index` of the set within its mask; `folder` has the masks, where they are files.
pub fn add(
    image: &mut ImageMetrics,
    index: usize,
    set: &TestSet<'_>,
    folder: Option<&Path>,
    networks: &Networks,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let (_, view) = set.views[index];
    let Some(mask) = mask(set, view, folder, params)? else { return Ok(()) };
    let [render, truth] = set.images(index, params)?;
    let mut scores = vec![(Metric::MaskedPsnr, masked_psnr(&render, &truth, &mask))];
    if [Metric::MaskedSsim, Metric::MaskedSsimStrict].iter().any(|metric| params.metrics.contains(metric)) {
        let ssim = masked_ssim(&render, &truth, &mask);
        scores.extend([(Metric::MaskedSsim, ssim.dycheck), (Metric::MaskedSsimStrict, ssim.strict)]);
    }
    if params.metrics.contains(&Metric::MaskedLpips) {
        scores.push((Metric::MaskedLpips, masked_lpips([render, truth], &mask, networks)));
    }
    image.values.extend(scores.into_iter().filter(|(metric, _)| params.metrics.contains(metric)));
    Ok(())
}

/// Images that are black outside of the mask, compared by pixel, mean over the mask.
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

/// Which pixels count; none where a view has no mask.
fn mask(
    set: &TestSet<'_>,
    view: &View,
    folder: Option<&Path>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<Option<Vec<bool>>> {
    let map = match (params.mask, folder) {
        (MaskSource::Labels, _) => set.capture.load_mask(view)?,
        (MaskSource::Files, Some(folder)) => Some(read(folder, view)?),
        (MaskSource::Files | MaskSource::None, _) => None,
    };
    let keeps = |label: u8| (label > 0) == (params.mask_keeps == Keep::Nonzero);
    Ok(map.map(|map| map.labels.into_iter().map(keeps).collect()))
}

/// The mask of a view: `NAME.png`, or `NAME.png.png` as one benchmark names them, of the view's size.
fn read(folder: &Path, view: &View) -> Result<LabelMap, Failure> {
    let files = ["png", "png.png"].map(|extension| folder.join(format!("{}.{extension}", view.name)));
    let [path, _] = &files;
    let found: Option<&PathBuf> = files.iter().find(|path| path.is_file());
    let missing = || {
        let hint = "masks are called as the capture's views, with the extension png";
        Failure::new(FailureKind::MissingData, format!("view {} has no mask", view.name)).hint(hint).at(path)
    };
    let path = found.ok_or_else(missing)?;
    let bad = |message: String| Failure::new(FailureKind::BadInput, message).at(path);
    let map = LabelMap::read(path).map_err(|error| bad(error.message))?;
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    if (map.width, map.height) == (width, height) {
        return Ok(map);
    }
    Err(bad(format!("mask is {}×{} px instead of {width}×{height}", map.width, map.height))
        .hint("masks are not resized: their edges would decide the figures"))
}
