//! Full-reference image metrics in f64, each by the definition that the splatting literature uses.

mod ms_ssim;
mod psnr;
mod ssim;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use ms_ssim::ms_ssim;
pub use psnr::{PSNR_CAP_DB, mean_squared_error, psnr_from_mse};
pub use ssim::{SsimMeans, ssim_means};

use crate::Image;

/// A figure of image quality; all of them are better when higher.
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
}

impl Metric {
    /// Every metric, in the order of tables.
    pub const ALL: [Self; 5] = [Self::Psnr, Self::PsnrPooled, Self::Ssim, Self::SsimValid, Self::MsSsim];

    /// The name in files and parameters.
    pub fn key(self) -> &'static str {
        match self {
            Self::Psnr => "psnr",
            Self::PsnrPooled => "psnr_pooled",
            Self::Ssim => "ssim",
            Self::SsimValid => "ssim_valid",
            Self::MsSsim => "ms_ssim",
        }
    }

    /// The name in tables.
    pub fn heading(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR",
            Self::PsnrPooled => "PSNR pooled",
            Self::Ssim => "SSIM",
            Self::SsimValid => "SSIM valid",
            Self::MsSsim => "MS-SSIM",
        }
    }

    /// Decimals that the literature prints, and that ranks are decided on.
    pub fn decimals(self) -> usize {
        if matches!(self, Self::Psnr | Self::PsnrPooled) { 2 } else { 4 }
    }

    /// `dB`, or nothing for an index.
    pub fn unit(self) -> &'static str {
        if matches!(self, Self::Psnr | Self::PsnrPooled) { "dB" } else { "" }
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
