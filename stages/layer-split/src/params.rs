//! Parameters of the stage.

use std::fmt;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use scene::Naming;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `layer-split`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The evidence for motion.
    pub source: LayerSource,
    /// For `files`: the folder of masks, relative to the data root, e.g. `priors/scene/mask`. It has a file per view, an array
    /// of all frames, or folders of either, one per object, which are united.
    pub folder: PathBuf,
    /// For `files`: what the names of its files refer to.
    pub naming: Naming,
    /// For masks of the capture and of `files`: which pixels move.
    pub polarity: Polarity,
    /// For `files`: pixels above this grey level are set, e.g. 127 for soft mattes.
    pub threshold: u8,
    /// For `residual-flow`: lower limit of the residual of a moving pixel, in pixels.
    pub min_residual_px: f64,
    /// For `residual-flow`: lower limit of the residual of a moving pixel, in standard deviations of the flow's noise.
    pub noise_multiple: f64,
    /// For `temporal-median`: lower limit of the difference of a moving pixel in any channel, of colours in [0, 1].
    pub min_difference: f64,
    /// For `temporal-median`: radius by which the differing pixels are widened.
    pub dilation_px: u32,
    /// For `residual-flow`: radius of the morphological closing; gaps of up to twice this width are closed.
    pub closing_px: u32,
    /// For `residual-flow`: minimum number of pixels of a component or hole; smaller ones count as noise.
    pub min_area_px: usize,
}

/// The evidence for motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LayerSource {
    /// The best available: masks of the capture and exact velocity, otherwise residual flow.
    #[default]
    Auto,
    /// Mask files in a folder.
    Files,
    /// Optical flow that camera motion does not explain.
    ResidualFlow,
    /// For static cameras: difference from the median over time of the training images of the same camera pose.
    TemporalMedian,
}

/// Which pixels of a mask move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Polarity {
    /// Set pixels move, as in most masks. Files with names of COLMAP's masks (`a.jpg.png`) whose pixels are mostly set are
    /// refused, because COLMAP's mark what is static.
    #[default]
    Auto,
    /// Set pixels move: RoMo, DAVIS, SAM 2, labels of moving instances.
    SetMoves,
    /// Set pixels are static: masks of the background, e.g. those that COLMAP reads.
    SetRests,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: LayerSource::Auto,
            folder: PathBuf::new(),
            naming: Naming::Auto,
            polarity: Polarity::Auto,
            threshold: 0,
            min_residual_px: 0.5, // below it, flow estimators disagree with each other
            noise_multiple: 5.0,  // exceeded by one in 10⁵ pixels of pure noise (Rayleigh)
            min_difference: 0.05, // above the noise of cameras
            dilation_px: 5,
            closing_px: 1,
            min_area_px: 4,
        }
    }
}

impl Params {
    /// Checks the values that the types do not restrict, and refuses values that the source does not read.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == LayerSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let checks = [
            (
                files && self.folder.as_os_str().is_empty(),
                "folder",
                "no folder given",
                "e.g. folder = \"priors/scene/mask\"",
            ),
            (
                !relative(&self.folder),
                "folder",
                "the folder must be below the data root",
                "use a relative path without `..`",
            ),
            (
                !files && !self.folder.as_os_str().is_empty(),
                "folder",
                "this source reads no folder",
                "set source = \"files\", or remove folder",
            ),
            (
                !not_negative(self.min_residual_px),
                "min_residual_px",
                "must be finite and not negative",
                "the default is 0.5",
            ),
            (
                !not_negative(self.noise_multiple),
                "noise_multiple",
                "must be finite and not negative",
                "the default is 5.0",
            ),
            (!(0.0..1.0).contains(&self.min_difference), "min_difference", "must be in [0, 1)", "the default is 0.05"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).chain(self.unread()).collect()
    }

    /// A problem for each value that differs from its default and that the source does not read.
    fn unread(&self) -> impl Iterator<Item = ParamProblem> {
        use LayerSource::{Auto, Files, ResidualFlow, TemporalMedian};
        let default = Self::default();
        // Without masks and velocity, `auto` takes residual flow.
        let of_flow: &[LayerSource] = &[ResidualFlow, Auto];
        let keys: [(&str, bool, &[LayerSource]); 9] = [
            ("naming", self.naming != default.naming, &[Files]),
            ("polarity", self.polarity != default.polarity, &[Files, Auto]),
            ("threshold", self.threshold != default.threshold, &[Files]),
            ("min_residual_px", self.min_residual_px != default.min_residual_px, of_flow),
            ("noise_multiple", self.noise_multiple != default.noise_multiple, of_flow),
            ("min_difference", self.min_difference != default.min_difference, &[TemporalMedian]),
            ("dilation_px", self.dilation_px != default.dilation_px, &[TemporalMedian]),
            ("closing_px", self.closing_px != default.closing_px, of_flow),
            ("min_area_px", self.min_area_px != default.min_area_px, of_flow),
        ];
        let source = self.source;
        let unread = keys.into_iter().filter(move |(_, differs, readers)| *differs && !readers.contains(&source));
        unread.map(move |(key, _, readers)| ParamProblem {
            key: key.into(),
            message: format!("source = \"{source}\" does not read it"),
            hint: Some(format!("remove {key}, or set source = \"{}\"", readers[0])),
        })
    }
}

impl fmt::Display for LayerSource {
    /// Writes the name in recipes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
