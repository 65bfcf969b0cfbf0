//! Parameters of the stage.

use std::path::{Component, PathBuf};

use engine::ParamProblem;
use scene::Naming;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `feature-import`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The origin of tokens and embeddings.
    pub source: FeatureSource,
    /// For `files`: the folder with `clip/` or `dino/` and, for prompts, `text.npy` and `prompts.txt`, relative to the data root.
    pub folder: PathBuf,
    /// For `files`: what the names of files of visual tokens refer to.
    pub naming: Naming,
    /// For `labels`: dimension F of the embeddings; at least the number of classes plus one for the background.
    pub dimension: usize,
    /// For `labels`: number of tokens along the longer side of an image.
    pub grid: u32,
    /// For `labels`: seed of the random embeddings.
    pub seed: u64,
}

/// The origin of tokens and embeddings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureSource {
    /// Exact features from the instance labels of the capture: one orthonormal embedding per class name.
    #[default]
    Labels,
    /// Files of an estimator, e.g. CLIP.
    Files,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: FeatureSource::Labels,
            folder: PathBuf::new(),
            naming: Naming::Auto,
            dimension: 64, // language-guided models reduce the 512 dimensions of CLIP to this
            grid: 32,      // attention over all tokens of an image has at most 1024² entries
            seed: 0,
        }
    }
}

impl Params {
    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let from_files = self.source == FeatureSource::Files;
        let below_root = self.folder.components().all(|part| matches!(part, Component::Normal(_)));
        let no_folder = self.folder.as_os_str().is_empty();
        let checks = [
            (from_files && no_folder, "folder", "no folder given", "e.g. folder = \"hypernerf/broom2/aux\""),
            (
                !from_files && !no_folder,
                "folder",
                "this source reads no folder",
                "set source = \"files\", or remove folder",
            ),
            (!below_root, "folder", "the folder must be below the data root", "use a relative path without `..`"),
            (self.dimension == 0, "dimension", "must be at least 1", "64 fits 63 classes and the background"),
            (self.grid == 0, "grid", "must be at least 1", "the default is 32"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
