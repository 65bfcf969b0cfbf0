//! Metrics in f64: of images, each by the definition that the splatting literature uses; of parts of images and of videos;
//! of surfaces and of what they mean, where a capture knows that exactly.

mod language;
mod masked;
mod metric;
mod ms_ssim;
mod psnr;
mod ssim;
mod surfaces;
#[cfg(test)]
mod tests;
mod video;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use language::{ClassFeatures, PromptLabels, class_features, feature_drifts, prompt_overlaps};
pub use masked::{MaskedSsim, masked_mean, masked_psnr, masked_ssim};
pub use metric::{Family, Metric};
pub use ms_ssim::ms_ssim;
pub use psnr::{PSNR_CAP_DB, mean_squared_error, psnr_from_mse};
pub use ssim::{SsimMeans, ssim_means};
pub use surfaces::{MovingError, Truths, judge_surfaces, psnr_of_moving};
pub use video::{consistencies, flow_difference, residual_change};

use crate::Image;

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
