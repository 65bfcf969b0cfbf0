//! The artifact: scores per image and their means, in `metrics.json`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context, ensure};
use engine::{Artifact, Failure, FailureKind};
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};

use crate::image_file::Quantise;
use crate::masks::{Keep, MaskName};
use crate::metrics::metric::Metric;
use crate::metrics::prompt_prior::TrivialOverlap;
use crate::metrics::psnr::psnr_from_mse;
use crate::metrics::score::Score;
use crate::metrics::surfaces::MovingError;
use crate::metrics::trivial::{Degenerate, MeanImage, MeanOver, Moments, Trivial};

/// Version of the metric definitions; values of different versions do not share a column.
pub(crate) const METRIC_VERSION: u32 = 3;

const FILE: &str = "metrics.json";

/// Masked metrics by mask.
pub(crate) type MaskedScores = BTreeMap<MaskName, BTreeMap<Metric, Score>>;

/// Scores of a set of images under one protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// The method that made the images; `external` for folders of images.
    pub method: String,
    /// The protocol of the images.
    pub protocol: Protocol,
    /// The evaluated split.
    pub split: Split,
    /// Version of the metric definitions.
    pub metric_version: u32,
    /// Quantisation of colours before the comparison.
    pub quantise: Quantise,
    /// The masks of masked metrics, with the mask values that select pixels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub masks: BTreeMap<MaskName, Keep>,
    /// One entry per image, in the order of the capture.
    pub images: Vec<ImageMetrics>,
    /// Means over the images, and metrics that are defined for a set only.
    pub means: BTreeMap<Metric, Score>,
    /// Means of masked metrics by mask, over the images that define them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub masked: MaskedScores,
    /// Mean [`Metric::PromptIou`] per prompt over the images with visible classes of that prompt; undefined for a prompt
    /// without a class.
    #[serde(default)]
    pub prompts: BTreeMap<String, Score>,
    /// Scores of answers that need no model for each prompt, over the same images as [`Metrics::prompts`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub trivial_prompts: BTreeMap<String, TrivialOverlap>,
    /// PSNR of images that need no model.
    pub trivial: Trivial,
    /// Number of evaluated images.
    pub n_images: usize,
}

/// Scores of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageMetrics {
    /// Name of the view, or stem of the file.
    pub name: String,
    /// Time of the view in seconds, if known.
    pub time_secs: Option<f64>,
    /// Index of the camera in a rig, if known.
    pub camera_index: Option<u32>,
    /// Mean squared error over pixels and channels, for colours in [0, 1].
    pub mse: f64,
    /// Variance of the render over its pixels, mean over the channels, for colours in [0, 1].
    pub render_variance: f64,
    /// Mean and variance of the ground truth.
    pub(crate) truth: Moments,
    /// Mean squared error of the mean of the other images; none without other images.
    pub mean_image_mse: Option<f64>,
    /// Share of the ground truth's pixels that have the capture's background colour; none without a capture.
    pub background_share: Option<f64>,
    /// Metrics of this image.
    pub values: BTreeMap<Metric, Score>,
    /// Masked metrics of this image by mask.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub masked: MaskedScores,
    /// Masked metrics of the mean of the other images.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub masked_mean_image: MaskedScores,
    /// The error on moving surfaces, if the capture has their velocity.
    #[serde(default)]
    pub moving: Option<MovingError>,
    /// The error of the mean of the other images on moving surfaces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving_mean_image: Option<MovingError>,
    /// The scores of a render without motion in the metrics of motion.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub without_motion: BTreeMap<Metric, f64>,
    /// Intersection over union per prompt with visible classes, if the model has prompts and the capture has labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub prompt_ious: BTreeMap<String, f64>,
    /// Scores of answers that need no model for these prompts.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub trivial_ious: BTreeMap<String, TrivialOverlap>,
    /// Caveats for the reader of the values.
    pub remarks: BTreeSet<Remark>,
}

/// A caveat about the scores of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remark {
    /// The render has the same colour everywhere.
    ConstantRender,
    /// The ground truth has the same colour everywhere.
    ConstantTruth,
    /// Render and ground truth are equal; the PSNR is capped.
    Identical,
}

impl Metrics {
    /// Computes the means of the per-image values and the pooled metrics in `wanted`.
    ///
    /// An image metric that is undefined for any image has no mean, because a mean over the others would belong to another
    /// set. A conditional metric ([`Metric::is_conditional`]) is averaged over the images that define it, and is absent if
    /// its inputs are.
    pub(crate) fn means_of(images: &[ImageMetrics], wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, Score> {
        let mean = |metric: &Metric| {
            let score = match metric {
                Metric::PsnrPooled => pooled_psnr(images),
                Metric::PsnrEmerging => emerging_psnr(images, |image| image.moving.as_ref())?,
                metric if metric.is_conditional() => {
                    mean_where_defined(images.iter().map(|image| &image.values), *metric)?
                }
                _ => mean_score(images, *metric),
            };
            Some((*metric, score))
        };
        wanted.iter().filter_map(mean).collect()
    }

    /// Computes the means of the masked metrics that `scores` selects by mask, over the images that define them.
    pub(crate) fn masked_means_of(images: &[ImageMetrics], scores: fn(&ImageMetrics) -> &MaskedScores) -> MaskedScores {
        let measured: BTreeSet<(MaskName, Metric)> = images
            .iter()
            .flat_map(scores)
            .flat_map(|(name, scores)| scores.keys().map(|metric| (*name, *metric)))
            .collect();
        let mut means = MaskedScores::new();
        for (name, metric) in measured {
            let of_mask = images.iter().filter_map(|image| scores(image).get(&name));
            means.entry(name).or_default().extend(mean_where_defined(of_mask, metric).map(|mean| (metric, mean)));
        }
        means
    }

    /// The mean over images of the PSNR of whole images, whatever metrics were computed; dB.
    pub fn full_psnr(&self) -> f64 {
        self.images.iter().map(|image| psnr_from_mse(image.mse)).sum::<f64>() / self.images.len() as f64
    }

    /// Why the renders show no more than an image that needs no model; none if they do, and none if the whole ground
    /// truth has one colour. `moves` states whether the model can show motion.
    pub fn degenerate(&self, moves: bool) -> Option<Degenerate> {
        let all_have = |remark| self.images.iter().all(|image| image.remarks.contains(&remark));
        let is_flat = all_have(Remark::ConstantRender) && !all_have(Remark::ConstantTruth);
        self.trivial.judge(self.full_psnr(), is_flat, moves)
    }

    /// Summarises the images' errors of trivial images; `over` names the images over which the mean images were taken.
    pub(crate) fn trivial_of(images: &[ImageMetrics], over: MeanOver) -> Trivial {
        let count = images.len() as f64;
        let mean = |value: &dyn Fn(&ImageMetrics) -> f64| images.iter().map(value).sum::<f64>() / count;
        let mean_of_all = |value: fn(&ImageMetrics) -> Option<f64>| -> Option<f64> {
            images.iter().map(value).sum::<Option<f64>>().map(|sum| sum / count)
        };
        let colour = std::array::from_fn(|c| mean(&|image| image.truth.mean[c]));
        let mean_image = mean_of_all(|image| image.mean_image_mse.map(psnr_from_mse));
        Trivial {
            colour,
            constant_psnr: mean(&|image| psnr_from_mse(image.truth.mse_of_constant(colour))),
            mean_image: mean_image.map(|psnr| MeanImage { psnr, over }),
            background_share: mean_of_all(|image| image.background_share),
            without_motion: means_without_motion(images),
            moving_mean_image: moving_means_of_mean_images(images),
            masked_mean_image: masked_means_of_mean_images(images),
            least_render_variance: images.iter().map(|image| image.render_variance).fold(f64::INFINITY, f64::min),
        }
    }

    /// Scores of trivial answers in [`Metric::PromptIou`], averaged in the same way: over the prompts of an image, then
    /// over the images. None if no image has prompts with visible classes.
    pub fn trivial_prompt_iou(&self) -> Option<TrivialOverlap> {
        let of_image =
            |image: &ImageMetrics| TrivialOverlap::mean(&image.trivial_ious.values().copied().collect::<Vec<_>>());
        TrivialOverlap::mean(&self.images.iter().filter_map(of_image).collect::<Vec<_>>())
    }

    /// Describes the conditions of the evaluation. Values share a column only if their protocols and these lines are equal.
    pub fn judged_by(&self) -> String {
        let split = self.split.name();
        let levels = match self.quantise {
            Quantise::Round8 => "8-bit levels (rounded)",
            Quantise::Trunc8 => "8-bit levels (truncated)",
            Quantise::None => "levels as stored",
        };
        let condition = |(name, keeps): (&MaskName, &Keep)| match keeps {
            Keep::Nonzero => String::new(),
            Keep::Zero => format!(" · {} masks mark excluded pixels", name.heading()),
            Keep::Half => format!(" · {} masks above one half", name.heading()),
        };
        let mask: String = self.masks.iter().map(condition).collect();
        format!("{split} images · {levels} · per-image means · metric version {}{mask}", self.metric_version)
    }

    /// The JSON text of `metrics.json`.
    pub(crate) fn to_json(&self) -> anyhow::Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Checks the metrics and writes `metrics.json` into `dir`.
    pub fn write(&self, dir: &Path) -> anyhow::Result<()> {
        self.check()?;
        let path = dir.join(FILE);
        std::fs::write(&path, self.to_json()?).with_context(|| format!("cannot write {}", path.display()))
    }
}

impl Artifact for Metrics {
    const NAME: &'static str = "metrics";
    const SCHEMA: u32 = 4;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(FILE);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("not a valid metrics file: {}", path.display()))
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.images.is_empty(), "the metrics contain no image");
        ensure!(
            self.n_images == self.images.len(),
            "there are {} images, but n_images is {}",
            self.images.len(),
            self.n_images
        );
        let names: BTreeSet<_> = self.images.iter().map(|image| &image.name).collect();
        ensure!(names.len() == self.images.len(), "two images have the same name");
        for image in &self.images {
            let errors = image.moving.iter().chain(&image.moving_mean_image);
            let moving_is_finite = errors.into_iter().all(|moving| moving.mse.is_finite() && moving.pixels > 0);
            ensure!(moving_is_finite, "the error on moving surfaces of {} is not finite", image.name);
            ensure!(
                image.mse.is_finite() && image.mse >= 0.0,
                "the mean squared error of {} is {}",
                image.name,
                image.mse
            );
            let overlaps_are_shares = image.prompt_ious.values().all(|overlap| (0.0..=1.0).contains(overlap));
            ensure!(overlaps_are_shares, "a prompt overlap of {} is outside of [0, 1]", image.name);
            for scores in image.masked.values().chain(image.masked_mean_image.values()).chain([&image.values]) {
                check_scores(scores).with_context(|| format!("image {}", image.name))?;
            }
        }
        for scores in self.masked.values().chain([&self.means]) {
            check_scores(scores).context("means")?;
        }
        ensure!(
            Self::masked_means_of(&self.images, |image| &image.masked) == self.masked,
            "the masked means differ from those of the images"
        );
        let recomputed = Self::means_of(&self.images, &self.means.keys().copied().collect());
        ensure!(recomputed == self.means, "the means differ from those of the images");
        let over = self.trivial.mean_image.map_or(MeanOver::AllImages, |mean| mean.over);
        let trivial = Self::trivial_of(&self.images, over);
        ensure!(trivial == self.trivial, "the errors of trivial images differ from those of the images");
        ensure!(trivial.is_finite(), "the error of a trivial image is not finite");
        let mut prompts = self.prompts.clone();
        prompts.retain(|_, score| score.value().is_some());
        ensure!(mean_overlaps(&self.images) == prompts, "the prompt overlaps differ from the means of the images");
        let trivial_prompts = mean_trivial_overlaps(&self.images);
        ensure!(trivial_prompts == self.trivial_prompts, "the trivial overlaps differ from the means of the images");
        Ok(())
    }
}

/// Checks that every value is finite: an undefined metric has its own variant and is never NaN.
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

/// The mean over the images whose scores define the metric. If none does, the reason of the first image; `None` if no
/// image was measured.
fn mean_where_defined<'a>(images: impl Iterator<Item = &'a BTreeMap<Metric, Score>>, metric: Metric) -> Option<Score> {
    let scores: Vec<&Score> = images.filter_map(|scores| scores.get(&metric)).collect();
    let values: Vec<f64> = scores.iter().filter_map(|score| score.value()).collect();
    let first = scores.first()?;
    Some(if values.is_empty() {
        (*first).clone()
    } else {
        Score::Value(values.iter().sum::<f64>() / values.len() as f64)
    })
}

/// Mean scores of renders without motion, over the images that define the metrics.
fn means_without_motion(images: &[ImageMetrics]) -> BTreeMap<Metric, f64> {
    let mut values = BTreeMap::<Metric, Vec<f64>>::new();
    for (metric, value) in images.iter().flat_map(|image| &image.without_motion) {
        values.entry(*metric).or_default().push(*value);
    }
    values.into_iter().map(|(metric, values)| (metric, values.iter().sum::<f64>() / values.len() as f64)).collect()
}

/// PSNR of the mean images on moving and on emerging surfaces, over the images that define them.
fn moving_means_of_mean_images(images: &[ImageMetrics]) -> BTreeMap<Metric, f64> {
    let psnr: Vec<f64> =
        images.iter().filter_map(|image| Some(psnr_from_mse(image.moving_mean_image.as_ref()?.mse))).collect();
    let moving = (!psnr.is_empty()).then(|| psnr.iter().sum::<f64>() / psnr.len() as f64);
    let emerging = emerging_psnr(images, |image| image.moving_mean_image.as_ref()).and_then(|score| score.value());
    let means = [(Metric::PsnrMoving, moving), (Metric::PsnrEmerging, emerging)];
    means.into_iter().filter_map(|(metric, mean)| Some((metric, mean?))).collect()
}

/// Mean masked metrics of the mean images, without those that no image defines.
fn masked_means_of_mean_images(images: &[ImageMetrics]) -> BTreeMap<MaskName, BTreeMap<Metric, f64>> {
    let means = Metrics::masked_means_of(images, |image| &image.masked_mean_image);
    let values = |scores: BTreeMap<Metric, Score>| {
        scores.into_iter().filter_map(|(metric, score)| Some((metric, score.value()?))).collect()
    };
    means.into_iter().map(|(name, scores)| (name, values(scores))).collect()
}

/// PSNR on moving surfaces from their errors, pooled over images with less than half as many moving pixels as the image
/// with most of them.
fn emerging_psnr(images: &[ImageMetrics], error: fn(&ImageMetrics) -> Option<&MovingError>) -> Option<Score> {
    let moving: Vec<&MovingError> = images.iter().filter_map(error).collect();
    let most = moving.iter().map(|error| error.pixels).max()?;
    let hidden: Vec<_> = moving.iter().filter(|error| 2 * error.pixels < most).collect();
    let pixels: usize = hidden.iter().map(|error| error.pixels).sum();
    if pixels == 0 {
        return Some(Score::undefined("no moving surface is ever half hidden"));
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

/// The mean overlap per prompt, over the images with visible classes of that prompt.
pub(crate) fn mean_overlaps(images: &[ImageMetrics]) -> BTreeMap<String, Score> {
    let mut values = BTreeMap::<&str, Vec<f64>>::new();
    for (prompt, overlap) in images.iter().flat_map(|image| &image.prompt_ious) {
        values.entry(prompt).or_default().push(*overlap);
    }
    let mean = |(prompt, values): (&str, Vec<f64>)| {
        (prompt.to_owned(), Score::Value(values.iter().sum::<f64>() / values.len() as f64))
    };
    values.into_iter().map(mean).collect()
}

/// Scores of trivial answers per prompt, over the images with visible classes of that prompt.
pub(crate) fn mean_trivial_overlaps(images: &[ImageMetrics]) -> BTreeMap<String, TrivialOverlap> {
    let mut values = BTreeMap::<&str, Vec<TrivialOverlap>>::new();
    for (prompt, overlap) in images.iter().flat_map(|image| &image.trivial_ious) {
        values.entry(prompt).or_default().push(*overlap);
    }
    values
        .into_iter()
        .filter_map(|(prompt, values)| Some((prompt.to_owned(), TrivialOverlap::mean(&values)?)))
        .collect()
}

/// The failure for a set without images.
pub(crate) fn empty_set(what: &str) -> Failure {
    Failure::new(FailureKind::BadInput, format!("the {what} has no images"))
}
