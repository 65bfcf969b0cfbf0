//! The parameters of the stage.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use crate::image_file::Quantise;
use crate::metrics::metric::Metric;

/// The parameters of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricEvaluationParams {
    /// Metrics to compute; by default all whose inputs are available.
    pub metrics: BTreeSet<Metric>,
    /// Quantisation of colours before the comparison; `round8` by default.
    pub quantise: Quantise,
    /// Folder with the weights of LPIPS, relative to the data root. If empty (the default), LPIPS is undefined.
    pub lpips_weights: PathBuf,
    /// Source of masks for masked metrics; with `none` (the default), there are no masked metrics.
    pub mask: MaskSource,
    /// For `mask = "files"`: folder with one mask `VIEW.png` per view, relative to the data root.
    pub mask_folder: PathBuf,
    /// Mask values that select pixels.
    pub mask_keeps: Keep,
    /// Folder with features and optical flow per render, relative to the data root. If empty (the default), there are no
    /// consistency metrics and no tOF.
    pub frame_features: PathBuf,
}

/// The source of masks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskSource {
    /// No masks.
    #[default]
    None,
    /// The capture's instance labels.
    Labels,
    /// Files, e.g. DyCheck's co-visibility masks.
    Files,
}

/// The mask values that select pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// All values but 0.
    #[default]
    Nonzero,
    /// The value 0, for masks that mark excluded pixels.
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
    /// All problems that the types do not exclude.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let is_outside = |path: &Path| !path.components().all(|part| matches!(part, Component::Normal(_)));
        let no_folder = self.mask_folder.as_os_str().is_empty();
        let from_files = self.mask == MaskSource::Files;
        let (outside, relative) = ("the folder must be below the data root", "use a relative path");
        let example = "e.g. mask_folder = \"iphone/{scene}/covisible/2x/val\"";
        let checks = [
            (self.metrics.is_empty(), "metrics", "there is no metric to compute", "omit the key to compute all"),
            (is_outside(&self.lpips_weights), "lpips_weights", outside, relative),
            (is_outside(&self.mask_folder), "mask_folder", outside, relative),
            (is_outside(&self.frame_features), "frame_features", outside, relative),
            (from_files && no_folder, "mask_folder", "mask = \"files\" needs a folder of masks", example),
            (
                !from_files && !no_folder,
                "mask_folder",
                "has no effect without mask = \"files\"",
                "set mask = \"files\", or remove mask_folder",
            ),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
