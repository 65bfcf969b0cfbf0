//! The parameters of the stage.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use crate::image_file::Quantise;
use crate::masks::Masks;
use crate::metrics::metric::Metric;

/// The parameters of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricEvaluationParams {
    /// Metrics to compute; by default all whose inputs are available.
    pub metrics: BTreeSet<Metric>,
    /// Quantisation of colours before the comparison; `round8` by default.
    pub quantise: Quantise,
    /// Folder with the weights of LPIPS, relative to the data root. Without the default folder LPIPS is undefined; any
    /// other folder must exist. If empty, LPIPS is undefined.
    pub lpips_weights: PathBuf,
    /// The masks, each with its own masked metrics; by default none.
    pub masks: Masks,
    /// Folder with features and optical flow per render, relative to the data root. If empty (the default), there are no
    /// consistency metrics and no tOF.
    pub frame_features: PathBuf,
}

/// The conventional folder of the weights of LPIPS, relative to the data root.
pub const LPIPS_FOLDER: &str = "lpips";

impl Default for MetricEvaluationParams {
    fn default() -> Self {
        Self {
            metrics: Metric::ALL.into(),
            quantise: Quantise::Round8,
            lpips_weights: LPIPS_FOLDER.into(),
            masks: Masks::default(),
            frame_features: PathBuf::new(),
        }
    }
}

impl MetricEvaluationParams {
    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let is_outside = |path: &Path| !path.components().all(|part| matches!(part, Component::Normal(_)));
        let (outside, relative) = ("the folder must be below the data root", "use a relative path");
        let of_masks = self.masks.folders().map(|(name, files)| (is_outside(&files.folder), name.folder_key()));
        let folders =
            [(is_outside(&self.lpips_weights), "lpips_weights"), (is_outside(&self.frame_features), "frame_features")];
        let nothing =
            (self.metrics.is_empty(), "metrics", "there is no metric to compute", "omit the key to compute all");
        let checks = folders.into_iter().chain(of_masks).map(|(found, key)| (found, key, outside, relative));
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.chain([nothing]).filter(|check| check.0).map(problem).collect()
    }
}
