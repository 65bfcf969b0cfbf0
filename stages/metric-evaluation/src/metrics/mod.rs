//! Full-reference metrics in f64: of images, each by the definition that the splatting literature uses, and of surfaces
//! where a capture knows them exactly.

mod language;
mod ms_ssim;
mod psnr;
mod ssim;
mod surfaces;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use language::{ClassFeatures, PromptLabels, class_features, feature_drifts, prompt_overlaps};
pub use ms_ssim::ms_ssim;
pub use psnr::{PSNR_CAP_DB, mean_squared_error, psnr_from_mse};
pub use ssim::{SsimMeans, ssim_means};
pub use surfaces::{MovingError, Truths, judge_surfaces, psnr_of_moving};

use crate::Image;

/// A figure of quality: of images, or of the surfaces that they show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Per-image PSNR in dB; a set's value is the mean over its images.
    Psnr,
    /// PSNR in dB of the mean squared error over all images (the original NeRF convention); defined for a set only.
    PsnrPooled,
    /// SSIM of 3D Gaussian Splatting: 11-tap Gaussian window, σ = 1.5, zero padding, mean over pixels and channels.
    Ssim,
    /// The same SSIM over the windows that lie inside the image (scikit-image, D-NeRF, `tf.image.ssim`).
    SsimValid,
    /// Multi-scale SSIM over five scales (`pytorch_msssim`).
    MsSsim,
    /// PSNR over the pixels whose true surface moves.
    PsnrMoving,
    /// The same, pooled over the images in which less than half as much of the moving surface is seen as in the image
    /// that sees most of it: while it goes behind something, and when it comes back. Defined for a set only.
    PsnrEmerging,
    /// Mean distance between rendered and true velocity of moving surfaces, scene units per second.
    VelocityError,
    /// Mean end-point error of the flow to the next frame on moving surfaces, pixels.
    FlowError,
    /// Mean difference in view-space z where render and truth show a surface, scene units.
    DepthError,
    /// Share of the truly covered pixels where the render covers less than half.
    HoleArea,
    /// Share of all pixels where the render shows a surface that is more than a tenth nearer than the true one, or
    /// where there is none.
    FloaterArea,
    /// Intersection over union of the pixels that a prompt selects and those labelled with its class, mean over the prompts
    /// in sight ([`prompt_overlaps`]).
    PromptIou,
    /// 1 − cosine between the mean feature of a class in an image and its mean over all images, mean over the classes in
    /// sight ([`feature_drifts`]).
    FeatureDrift,
}

/// What a metric is called, how it is printed, and what it is computed from.
struct Definition {
    key: &'static str,
    heading: &'static str,
    unit: &'static str,
    decimals: usize,
    higher_is_better: bool,
    of_surfaces: bool,
}

impl Metric {
    /// Every metric, in the order of tables.
    pub const ALL: [Self; 14] = [
        Self::Psnr,
        Self::PsnrPooled,
        Self::Ssim,
        Self::SsimValid,
        Self::MsSsim,
        Self::PsnrMoving,
        Self::PsnrEmerging,
        Self::VelocityError,
        Self::FlowError,
        Self::DepthError,
        Self::HoleArea,
        Self::FloaterArea,
        Self::PromptIou,
        Self::FeatureDrift,
    ];

    fn definition(self) -> Definition {
        let image = |key, heading, unit, decimals| Definition {
            key,
            heading,
            unit,
            decimals,
            higher_is_better: true,
            of_surfaces: false,
        };
        let error = |key, heading, unit, decimals| Definition {
            higher_is_better: false,
            of_surfaces: true,
            ..image(key, heading, unit, decimals)
        };
        let known = |key, heading, decimals| Definition { of_surfaces: true, ..image(key, heading, "", decimals) };
        let moving = |key, heading| Definition { of_surfaces: true, ..image(key, heading, "dB", 2) };
        // Decimals of the first five are those that the literature prints.
        match self {
            Self::Psnr => image("psnr", "PSNR", "dB", 2),
            Self::PsnrPooled => image("psnr_pooled", "PSNR pooled", "dB", 2),
            Self::Ssim => image("ssim", "SSIM", "", 4),
            Self::SsimValid => image("ssim_valid", "SSIM valid", "", 4),
            Self::MsSsim => image("ms_ssim", "MS-SSIM", "", 4),
            Self::PsnrMoving => moving("psnr_moving", "PSNR moving"),
            Self::PsnrEmerging => moving("psnr_emerging", "PSNR emerging"),
            Self::VelocityError => error("velocity_error", "velocity error", "1/s", 3),
            Self::FlowError => error("flow_error", "flow error", "px", 3),
            Self::DepthError => error("depth_error", "depth error", "", 4),
            Self::HoleArea => error("hole_area", "holes", "", 4),
            Self::FloaterArea => error("floater_area", "floaters", "", 4),
            Self::PromptIou => known("prompt_iou", "prompt IoU", 3),
            Self::FeatureDrift => error("feature_drift", "feature drift", "", 4),
        }
    }

    /// The name in files and parameters.
    pub fn key(self) -> &'static str {
        self.definition().key
    }

    /// The name in tables.
    pub fn heading(self) -> &'static str {
        self.definition().heading
    }

    /// Decimals in tables, and that ranks are decided on.
    pub fn decimals(self) -> usize {
        self.definition().decimals
    }

    /// `dB`, `px`, or nothing for an index, a share and scene units.
    pub fn unit(self) -> &'static str {
        self.definition().unit
    }

    /// Whether more is better.
    pub fn higher_is_better(self) -> bool {
        self.definition().higher_is_better
    }

    /// Whether the figure needs more of the capture than images: exact maps or labels. It is absent where the capture has
    /// none, or where the model cannot say anything about it.
    pub fn is_of_surfaces(self) -> bool {
        self.definition().of_surfaces
    }
}

/// A metric's outcome: a finite number, or why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Score {
    /// A finite number.
    Value(f64),
    /// The metric does not exist for this input.
    Undefined {
        /// Why, as `image smaller than 161 px`.
        undefined: String,
    },
}

impl Score {
    /// An undefined score with its reason.
    pub fn undefined(reason: impl Into<String>) -> Self {
        Self::Undefined { undefined: reason.into() }
    }

    /// The number, if there is one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value(value) => Some(*value),
            Self::Undefined { .. } => None,
        }
    }
}

/// Judges one pair of equally large images by every per-image metric in `wanted`.
///
/// The three SSIM figures share the window sums of the full-resolution images.
pub fn judge(render: &Image, truth: &Image, wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, Score> {
    let mut scores = BTreeMap::new();
    if wanted.contains(&Metric::Psnr) {
        scores.insert(Metric::Psnr, Score::Value(psnr_from_mse(mean_squared_error(render, truth))));
    }
    let similarity = [Metric::Ssim, Metric::SsimValid, Metric::MsSsim];
    if similarity.iter().any(|metric| wanted.contains(metric)) {
        let channels = [0, 1, 2].map(|c| ssim_means(&render.planes[c], &truth.planes[c], render.width));
        let mut all = BTreeMap::from([
            (Metric::Ssim, Score::Value(channels.iter().map(|means| means.zero_padded).sum::<f64>() / 3.0)),
            (Metric::SsimValid, mean_of_channels(&channels, |means| means.valid)),
            (Metric::MsSsim, ms_ssim(render, truth, &channels)),
        ]);
        all.retain(|metric, _| wanted.contains(metric));
        scores.append(&mut all);
    }
    scores
}

/// Mean over the three channels of a figure that needs at least one whole window.
fn mean_of_channels(channels: &[SsimMeans; 3], figure: impl Fn(&SsimMeans) -> Option<f64>) -> Score {
    match channels.iter().map(figure).sum::<Option<f64>>() {
        Some(sum) => Score::Value(sum / 3.0),
        None => Score::undefined(format!("image smaller than {} px", ssim::TAPS)),
    }
}
