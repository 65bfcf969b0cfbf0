//! What a recipe may say about layers.

use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `layer-split`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What decides.
    pub source: LayerSource,
    /// `files`: the folder of masks, relative to the data root, as `priors/scene/mask`.
    pub folder: PathBuf,
    /// Masks: which pixels move.
    pub polarity: Polarity,
    /// `files`: pixels above this grey level are set; 127 for soft mattes.
    pub threshold: u8,
    /// `residual-flow`: a pixel moves if its flow differs by more than this from that of a world at rest …
    pub min_residual_px: f64,
    /// … and by more than this multiple of the noise of the view's flow.
    pub noise_multiple: f64,
    /// `residual-flow`: gaps up to twice as wide are closed.
    pub closing_px: u32,
    /// `residual-flow`: smaller parts and smaller holes are noise.
    pub min_area_px: usize,
}

/// What decides what moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LayerSource {
    /// What there is: the capture's masks and exact velocity; without them residual flow.
    #[default]
    Auto,
    /// Masks in a folder.
    Files,
    /// Flow that the camera's motion does not explain.
    ResidualFlow,
}

/// Which pixels of a mask move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Polarity {
    /// Those that are set: RoMo, DAVIS, labels of moving instances.
    #[default]
    SetMoves,
    /// Those that are not: masks of the static part.
    SetRests,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: LayerSource::Auto,
            folder: PathBuf::new(),
            polarity: Polarity::SetMoves,
            threshold: 0,
            min_residual_px: 0.5, // below, estimators of flow disagree with each other
            noise_multiple: 5.0,  // of 10⁵ pixels of noise (Rayleigh), one is farther out
            closing_px: 1,
            min_area_px: 4,
        }
    }
}

impl Params {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == LayerSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let checks = [
            (files && self.folder.as_os_str().is_empty(), "folder", "no folder", "folder = \"priors/scene/mask\""),
            (!relative(&self.folder), "folder", "the folder must lie below the data root", "use a relative path"),
            (
                !files && !self.folder.as_os_str().is_empty(),
                "folder",
                "no folder is read",
                "set source = \"files\", or remove folder",
            ),
            (!not_negative(self.min_residual_px), "min_residual_px", "must be finite and not negative", "0.5"),
            (!not_negative(self.noise_multiple), "noise_multiple", "must be finite and not negative", "5.0"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
