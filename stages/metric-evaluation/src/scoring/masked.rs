//! Adds metrics of the masked part of each image.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::mask_file::MaskFile;
use scene::{LabelMap, View};

use super::perceptual::Networks;
use crate::artifact::MaskedScores;
use crate::image_file::Image;
use crate::lpips::{Backbone, InputRange};
use crate::metrics::masked::{masked_mean, masked_psnr, masked_ssim};
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::params::MetricEvaluationParams;
use crate::test_set::TestSet;

/// The masked metrics of the images of a split.
pub(crate) struct Masked<'a> {
    pub(crate) set: &'a TestSet<'a>,
    pub(crate) params: &'a MetricEvaluationParams,
    pub(crate) networks: &'a Networks,
    /// Absolute paths of the folders that the parameters name.
    pub(crate) folders: &'a BTreeMap<String, PathBuf>,
}

impl Masked<'_> {
    /// Whether the parameters name a masked metric and a mask.
    pub(crate) fn is_wanted(&self) -> bool {
        self.params.metrics.iter().any(|metric| metric.is_masked()) && self.params.masks.used().next().is_some()
    }

    /// The metrics, by mask, of an image and the ground truth of the view at `index`. Labels of the capture are left out for
    /// a view without labels.
    pub(crate) fn scores(&self, index: usize, images: &[Image; 2]) -> anyhow::Result<MaskedScores> {
        let (_, view) = self.set.views[index];
        let mut scores = MaskedScores::new();
        for mask in self.params.masks.used() {
            let map = match (mask.files, self.folders.get(mask.name.key())) {
                (Some(files), None) => {
                    let reason = format!("no {} masks: {} is missing", mask.name.heading(), files.folder.display());
                    let undefined = Metric::ALL.into_iter().map(|metric| (metric, Score::undefined(&reason)));
                    scores.insert(mask.name, self.wanted(undefined));
                    continue;
                }
                (Some(_), Some(folder)) => Some(read(folder, view)?),
                (None, _) => self.set.capture.load_mask(view)?,
            };
            if let Some(map) = map {
                let pixels: Vec<bool> = map.labels.into_iter().map(|value| mask.keeps.selects(value)).collect();
                scores.insert(mask.name, self.wanted(self.of_mask(images, &pixels)));
            }
        }
        Ok(scores)
    }

    fn wanted(&self, scores: impl IntoIterator<Item = (Metric, Score)>) -> BTreeMap<Metric, Score> {
        let is_wanted = |metric: Metric| metric.is_masked() && self.params.metrics.contains(&metric);
        scores.into_iter().filter(|(metric, _)| is_wanted(*metric)).collect()
    }

    fn of_mask(&self, images: &[Image; 2], mask: &[bool]) -> Vec<(Metric, Score)> {
        let [image, truth] = images;
        let mut scores = vec![(Metric::MaskedPsnr, masked_psnr(image, truth, mask))];
        if [Metric::MaskedSsim, Metric::MaskedSsimStrict].iter().any(|metric| self.params.metrics.contains(metric)) {
            let ssim = masked_ssim(image, truth, mask);
            scores.extend([(Metric::MaskedSsim, ssim.dycheck), (Metric::MaskedSsimStrict, ssim.strict)]);
        }
        if self.params.metrics.contains(&Metric::MaskedLpips) {
            scores.push((Metric::MaskedLpips, masked_lpips(images.clone(), mask, self.networks)));
        }
        scores
    }
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
    let levels = MaskFile::read(path).map_err(|error| bad(format!("cannot read the mask: {error}")))?.levels;
    let map = LabelMap { width: levels.width(), height: levels.height(), labels: levels.into_raw() };
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    if (map.width, map.height) == (width, height) {
        return Ok(map);
    }
    Err(bad(format!("the mask is {}×{} px instead of {width}×{height}", map.width, map.height))
        .hint("provide masks of this size: resizing would move their edges"))
}
