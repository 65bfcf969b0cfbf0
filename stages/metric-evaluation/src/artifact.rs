//! The artifact: per-image scores and their means, in `metrics.json`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context, ensure};
use engine::{Artifact, Failure, FailureKind};
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};

use crate::judges::language::mean_overlaps;
use crate::metrics::{MovingError, psnr_from_mse};
use crate::{Keep, MaskSource, Metric, Quantise, Score};

/// The version of the metrics' definitions: numbers of different versions share no column.
pub const METRIC_VERSION: u32 = 2;

const FILE: &str = "metrics.json";

/// Scores of a set of images under one protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// The method that made the images; `external` for images by anybody.
    pub method: String,
    /// How the images came to be what they are.
    pub protocol: Protocol,
    /// Which split was judged.
    pub split: Split,
    /// [`METRIC_VERSION`] of the code that judged.
    pub metric_version: u32,
    /// Levels that colours were brought to before they were compared.
    pub quantise: Quantise,
    /// Which pixels the masked figures are over.
    #[serde(default)]
    pub mask: MaskSource,
    /// Which values of the masks are kept.
    #[serde(default)]
    pub mask_keeps: Keep,
    /// One entry per image, in the order of the capture.
    pub images: Vec<ImageMetrics>,
    /// Means over the images, and the figures that only a set has.
    pub means: BTreeMap<Metric, Score>,
    /// [`Metric::PromptIou`] by prompt, over the images that show what the prompt means; a prompt that is no class says so.
    #[serde(default)]
    pub prompts: BTreeMap<String, Score>,
    /// How many images were judged.
    pub n_images: usize,
}

/// Scores of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageMetrics {
    /// The view's name, or the file's stem.
    pub name: String,
    /// When the image was taken, where that is known.
    pub time_secs: Option<f64>,
    /// Which camera of the rig, where that is known.
    pub camera_index: Option<u32>,
    /// Mean squared error over pixels and channels, colours in [0, 1].
    pub mse: f64,
    /// The per-image metrics.
    pub values: BTreeMap<Metric, Score>,
    /// The error on moving surfaces, where the capture knows them.
    #[serde(default)]
    pub moving: Option<MovingError>,
    /// Intersection over union by prompt in sight, where the model answers prompts and the capture has labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub prompt_ious: BTreeMap<String, f64>,
    /// What a reader should know before trusting the values.
    pub remarks: BTreeSet<Remark>,
}

/// A reason to look at an image before trusting its scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remark {
    /// The render has the same colour everywhere.
    ConstantRender,
    /// The truth has the same colour everywhere.
    ConstantTruth,
    /// The images are equal; the PSNR is the cap.
    Identical,
}

impl Metrics {
    /// Means of the per-image values, and the pooled figures that are in `wanted`.
    ///
    /// An image metric that is undefined for any image has no mean: a mean over the others would be one over another
    /// set. A figure of surfaces is a mean over the images that show such surfaces, and absent where no truth is known.
    pub fn means_of(images: &[ImageMetrics], wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, Score> {
        let mean = |metric: &Metric| {
            let score = match metric {
                Metric::PsnrPooled => pooled_psnr(images),
                Metric::PsnrEmerging => emerging_psnr(images)?,
                metric if metric.is_conditional() => mean_where_defined(images, *metric)?,
                _ => mean_score(images, *metric),
            };
            Some((*metric, score))
        };
        wanted.iter().filter_map(mean).collect()
    }

    /// Who judged what: numbers share a column only if their protocols and these lines are equal.
    pub fn judged_by(&self) -> String {
        let split = match self.split {
            Split::Train => "train",
            Split::Val => "val",
            Split::Test => "test",
        };
        let levels = match self.quantise {
            Quantise::Round8 => "8-bit levels (rounded)",
            Quantise::Trunc8 => "8-bit levels (truncated)",
            Quantise::None => "levels as stored",
        };
        let mask = match (self.mask, self.mask_keeps) {
            (MaskSource::None, _) => "",
            (MaskSource::Labels, Keep::Nonzero) => " · masked by labels",
            (MaskSource::Labels, Keep::Zero) => " · masked by the background's label",
            (MaskSource::Files, Keep::Nonzero) => " · masked by files",
            (MaskSource::Files, Keep::Zero) => " · masked by files that mark what does not count",
        };
        format!("{split} images · {levels} · per-image means · metric version {}{mask}", self.metric_version)
    }

    /// The JSON text of `metrics.json`.
    pub fn to_json(&self) -> anyhow::Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Checks the value and writes it into `dir`.
    pub fn write(&self, dir: &Path) -> anyhow::Result<()> {
        self.check()?;
        let path = dir.join(FILE);
        std::fs::write(&path, self.to_json()?).with_context(|| format!("cannot write {}", path.display()))
    }
}

impl Artifact for Metrics {
    const NAME: &'static str = "metrics";
    const SCHEMA: u32 = 2;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(FILE);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is not a set of metrics", path.display()))
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.images.is_empty(), "metrics of no image");
        ensure!(self.n_images == self.images.len(), "{} images, but n_images = {}", self.images.len(), self.n_images);
        let names: BTreeSet<_> = self.images.iter().map(|image| &image.name).collect();
        ensure!(names.len() == self.images.len(), "two images have the same name");
        for image in &self.images {
            let moving_is_finite = image.moving.is_none_or(|moving| moving.mse.is_finite() && moving.pixels > 0);
            ensure!(moving_is_finite, "the error on moving surfaces of {} is not finite", image.name);
            ensure!(image.mse.is_finite() && image.mse >= 0.0, "mean squared error of {} is {}", image.name, image.mse);
            let overlaps_are_shares = image.prompt_ious.values().all(|overlap| (0.0..=1.0).contains(overlap));
            ensure!(overlaps_are_shares, "an overlap of prompts in {} is no share", image.name);
            check_scores(&image.values).with_context(|| format!("image {}", image.name))?;
        }
        check_scores(&self.means).context("means")?;
        let recomputed = Self::means_of(&self.images, &self.means.keys().copied().collect());
        ensure!(recomputed == self.means, "means are not the means of the images");
        let mut prompts = self.prompts.clone();
        prompts.retain(|_, score| score.value().is_some());
        ensure!(mean_overlaps(&self.images) == prompts, "overlaps of prompts are not the means of the images");
        Ok(())
    }
}

/// Every number must be finite: an undefined metric is a typed outcome, never NaN.
fn check_scores(scores: &BTreeMap<Metric, Score>) -> anyhow::Result<()> {
    for (metric, score) in scores {
        ensure!(score.value().is_none_or(f64::is_finite), "{} is not finite", metric.key());
    }
    Ok(())
}

fn mean_score(images: &[ImageMetrics], metric: Metric) -> Score {
    let mut sum = 0.0;
    for image in images {
        match image.values.get(&metric) {
            Some(Score::Value(value)) => sum += value,
            Some(undefined) => return undefined.clone(),
            None => return Score::undefined(format!("not measured for {}", image.name)),
        }
    }
    if images.is_empty() { Score::undefined("no images") } else { Score::Value(sum / images.len() as f64) }
}

/// The mean over the images that define the figure; `None` where no image knows the truth.
fn mean_where_defined(images: &[ImageMetrics], metric: Metric) -> Option<Score> {
    let scores: Vec<&Score> = images.iter().filter_map(|image| image.values.get(&metric)).collect();
    let values: Vec<f64> = scores.iter().filter_map(|score| score.value()).collect();
    let first = scores.first()?;
    Some(if values.is_empty() {
        (*first).clone()
    } else {
        Score::Value(values.iter().sum::<f64>() / values.len() as f64)
    })
}

/// PSNR on moving surfaces over the images that see less than half as much of them as the one that sees most.
fn emerging_psnr(images: &[ImageMetrics]) -> Option<Score> {
    let moving: Vec<&MovingError> = images.iter().filter_map(|image| image.moving.as_ref()).collect();
    let most = moving.iter().map(|error| error.pixels).max()?;
    let hidden: Vec<_> = moving.iter().filter(|error| 2 * error.pixels < most).collect();
    let pixels: usize = hidden.iter().map(|error| error.pixels).sum();
    if pixels == 0 {
        return Some(Score::undefined("nothing that moves is ever half hidden"));
    }
    let sum: f64 = hidden.iter().map(|error| error.mse * error.pixels as f64).sum();
    Some(Score::Value(psnr_from_mse(sum / pixels as f64)))
}

fn pooled_psnr(images: &[ImageMetrics]) -> Score {
    if images.is_empty() {
        return Score::undefined("no images");
    }
    Score::Value(psnr_from_mse(images.iter().map(|image| image.mse).sum::<f64>() / images.len() as f64))
}

/// The failure for a set without images.
pub(crate) fn empty_set(what: &str) -> Failure {
    Failure::new(FailureKind::BadInput, format!("{what} has no images to judge"))
}
