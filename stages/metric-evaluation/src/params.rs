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
    /// Checks the values that the types do not restrict, and refuses what has no effect.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let is_outside = |path: &Path| !path.components().all(|part| matches!(part, Component::Normal(_)));
        let (outside, relative) = ("the folder must be below the data root", "use a relative path");
        let of_masks = self.masks.folders().map(|(name, files)| (is_outside(&files.folder), name.folder_key()));
        let folders =
            [(is_outside(&self.lpips_weights), "lpips_weights"), (is_outside(&self.frame_features), "frame_features")];
        let nothing =
            (self.metrics.is_empty(), "metrics", "there is no metric to compute", "omit the key to compute all");
        let checks = folders.into_iter().chain(of_masks).map(|(found, key)| (found, key, outside, relative));
        let found = checks.chain([nothing]).filter(|check| check.0);
        let found = found.map(|(_, key, message, hint)| problem(key, message, hint));
        found.chain(self.without_input()).collect()
    }

    /// Metrics that the recipe names and whose input it does not. The default, all metrics, names none.
    fn without_input(&self) -> Vec<ParamProblem> {
        let is_named = |metric: Metric| self.metrics.len() < Metric::ALL.len() && self.metrics.contains(&metric);
        let has_mask = self.masks.used().next().is_some();
        let has_features = !self.frame_features.as_os_str().is_empty();
        let lacking = |metric: Metric| {
            if metric.is_masked() && !has_mask {
                Some(("a mask", "name its folder, e.g. masks.foreground.folder, or set masks.labels = \"nonzero\""))
            } else if metric.is_of_features() && !has_features {
                Some(("frame_features", "set frame_features"))
            } else {
                None
            }
        };
        let named = Metric::ALL.into_iter().filter(|&metric| is_named(metric));
        let lacking = named.filter_map(|metric| Some((metric, lacking(metric)?)));
        let refused = lacking.map(|(metric, (input, hint))| {
            // The name as a recipe spells it, in quotes.
            let message = format!("{} needs {input}", serde_json::json!(metric));
            problem("metrics", &message, &format!("{hint}, or remove the metric"))
        });
        refused.collect()
    }
}

fn problem(key: &str, message: &str, hint: &str) -> ParamProblem {
    ParamProblem { key: key.into(), message: message.into(), hint: Some(hint.into()) }
}
