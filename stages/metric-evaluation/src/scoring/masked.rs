//! Adds metrics of the masked part of each image.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{LabelMap, View};

use super::perceptual::Networks;
use crate::artifact::ImageMetrics;
use crate::image_file::Image;
use crate::lpips::{Backbone, InputRange};
use crate::metrics::masked::{masked_mean, masked_psnr, masked_ssim};
use crate::metrics::metric::{Family, Metric};
use crate::metrics::score::Score;
use crate::params::{Keep, MaskSource, MetricEvaluationParams};
use crate::test_set::TestSet;

/// Whether any masked metric is wanted.
pub(crate) fn is_wanted(params: &MetricEvaluationParams) -> bool {
    params.mask != MaskSource::None && params.metrics.iter().any(|metric| metric.family() == Family::Masked)
}

/// Adds masked metrics of the image at `index`; `folder` contains the masks if they are files.
pub(crate) fn add(
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

/// LPIPS by pixel of images that are black outside of the mask, averaged over the mask.
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

/// The mask of a view; `None` if it has no mask.
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
