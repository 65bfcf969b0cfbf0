//! Where tokens and embeddings come from.

use std::path::{Component, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `feature-import`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Who computes tokens and embeddings.
    pub source: FeatureSource,
    /// `files`: the folder that holds `clip/`, `text.npy` and `prompts.txt`, relative to the data root.
    pub folder: PathBuf,
    /// `labels`: F, the length of embeddings; at least the number of classes plus one for the background.
    pub dimension: usize,
    /// `labels`: tokens along the longer side of an image.
    pub grid: u32,
    /// `labels`: of the random embeddings.
    pub seed: u64,
}

/// Who computes tokens and embeddings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureSource {
    /// Exact ones from the capture's instance labels: an orthonormal embedding per class name.
    #[default]
    Labels,
    /// Those of an estimator, as CLIP, in files.
    Files,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: FeatureSource::Labels,
            folder: PathBuf::new(),
            dimension: 64, // what language-guided models reduce CLIP's 512 to
            grid: 32,      // attention over all tokens of an image stays below 1024²
            seed: 0,
        }
    }
}

impl Params {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let from_files = self.source == FeatureSource::Files;
        let below_root = self.folder.components().all(|part| matches!(part, Component::Normal(_)));
        let no_folder = self.folder.as_os_str().is_empty();
        let checks = [
            (from_files && no_folder, "folder", "no folder of features", "folder = \"hypernerf/broom2/aux\""),
            (!from_files && !no_folder, "folder", "nothing is read from a folder", "set source = \"files\""),
            (!below_root, "folder", "the folder must lie below the data root", "use a relative path"),
            (self.dimension == 0, "dimension", "an embedding needs at least one value", "64 holds 63 classes"),
            (self.grid == 0, "grid", "must be at least 1", "32 is the most that attention over all tokens can bear"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
