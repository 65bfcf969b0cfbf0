//! Parameters of the stage.

use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use scene::Naming;
use scene::maps::DepthKind;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `inpaint-import`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The origin of filled pixels.
    pub source: FillSource,
    /// For `files`: the folder of inpainted frames, relative to the data root.
    pub folder: PathBuf,
    /// For `files`: what the names of files refer to.
    pub naming: Naming,
    /// For `files`: the folder with the depth of the inpainted frames. If unset, the depth around the moving pixels is
    /// continued smoothly.
    pub depth_folder: Option<PathBuf>,
    /// For `files`: the quantity that these depth files store.
    pub depth_kind: DepthKind,
    /// Dilation of the masks in pixels, because masks end within blurred edges.
    pub margin_px: u32,
    /// For `propagate`: maximum number of source views, evenly spaced over the training views.
    pub max_sources: usize,
}

/// The origin of filled pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FillSource {
    /// Other views, which see the hidden pixels.
    #[default]
    Propagate,
    /// Frames of a video inpainter.
    Files,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: FillSource::Propagate,
            folder: PathBuf::new(),
            naming: Naming::Auto,
            depth_folder: None,
            depth_kind: DepthKind::Z,
            margin_px: 2,
            max_sources: 48,
        }
    }
}

impl Params {
    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == FillSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let depth_folder = self.depth_folder.as_deref();
        let checks = [
            (
                files && self.folder.as_os_str().is_empty(),
                "folder",
                "no folder given",
                "e.g. folder = \"priors/scene/inpaint\"",
            ),
            (
                !relative(&self.folder),
                "folder",
                "the folder must be below the data root",
                "use a relative path without `..`",
            ),
            (
                !depth_folder.is_none_or(relative),
                "depth_folder",
                "the folder must be below the data root",
                "use a relative path without `..`",
            ),
            (
                !files && (!self.folder.as_os_str().is_empty() || depth_folder.is_some()),
                "folder",
                "this source reads no folder",
                "set source = \"files\", or remove the folders",
            ),
            (self.max_sources == 0, "max_sources", "must be at least 1", "the default is 48"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
