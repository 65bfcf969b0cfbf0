//! Parameters of the stage.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use crate::Metric;

/// What to measure, and on which images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricEvaluationParams {
    /// Metrics to compute; all by default, as far as their inputs are given.
    pub metrics: BTreeSet<Metric>,
    /// Levels that colours are brought to before they are compared; `round8` by default.
    pub quantise: Quantise,
    /// The folder with the weights of LPIPS, relative to the data root; none by default, and then there is no LPIPS.
    pub lpips_weights: PathBuf,
    /// Which pixels masked metrics are over; `none` by default, and then there are none.
    pub mask: MaskSource,
    /// `files`: the folder of masks, one `VIEW.png` per view, relative to the data root.
    pub mask_folder: PathBuf,
    /// Which values of a mask are kept.
    pub mask_keeps: Keep,
    /// The folder with a feature vector per render, relative to the data root; none by default, and then there is no
    /// consistency.
    pub frame_features: PathBuf,
}

/// Where masks come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskSource {
    /// Nowhere.
    #[default]
    None,
    /// The capture's instance labels.
    Labels,
    /// Files, as DyCheck's masks of co-visibility.
    Files,
}

/// Which values of a mask are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// All but 0.
    #[default]
    Nonzero,
    /// 0, as where masks mark what does not count.
    Zero,
}

impl Default for MetricEvaluationParams {
    fn default() -> Self {
        Self {
            metrics: Metric::ALL.into(),
            quantise: Quantise::Round8,
            lpips_weights: PathBuf::new(),
            mask: MaskSource::None,
            mask_folder: PathBuf::new(),
            mask_keeps: Keep::Nonzero,
            frame_features: PathBuf::new(),
        }
    }
}

impl MetricEvaluationParams {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let is_outside = |path: &Path| !path.components().all(|part| matches!(part, Component::Normal(_)));
        let no_folder = self.mask_folder.as_os_str().is_empty();
        let from_files = self.mask == MaskSource::Files;
        let (outside, relative) = ("the folder must lie below the data root", "use a relative path");
        let example = "mask_folder = \"iphone/{scene}/covisible/2x/val\"";
        let checks = [
            (self.metrics.is_empty(), "metrics", "no metric to compute", "leave the key out to compute all"),
            (is_outside(&self.lpips_weights), "lpips_weights", outside, relative),
            (is_outside(&self.mask_folder), "mask_folder", outside, relative),
            (is_outside(&self.frame_features), "frame_features", outside, relative),
            (from_files && no_folder, "mask_folder", "no folder of masks", example),
            (!from_files && !no_folder, "mask_folder", "nothing is read from a folder", "set mask = \"files\""),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}

/// Levels that colours are brought to before they are compared.
///
/// The splatting papers score the 8-bit files that they saved. 8-bit opaque images are the same under each choice;
/// 16-bit images and composited transparency are not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quantise {
    /// To the nearest of 256 levels, halves up (`torchvision.utils.save_image`).
    #[default]
    Round8,
    /// To the next lower of 256 levels (an integer cast, as 4DGaussians composites its truth).
    Trunc8,
    /// As stored.
    None,
}

impl Quantise {
    /// The nearest allowed level of a colour in [0, 1].
    pub fn apply(self, colour: f64) -> f64 {
        // A colour that is a whole level up to rounding error must keep that level under truncation.
        const ROUNDING: f64 = 1e-9;
        match self {
            Self::Round8 => (colour * 255.0 + 0.5).floor() / 255.0,
            Self::Trunc8 => (colour * 255.0 + ROUNDING).floor() / 255.0,
            Self::None => colour,
        }
    }
}
