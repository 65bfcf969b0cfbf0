//! What a recipe may say about the background.

use std::path::{Component, Path, PathBuf};

use depth_flow_import::params::DepthKind;
use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `inpaint-import`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Where filled pixels come from.
    pub source: FillSource,
    /// `files`: the folder of inpainted frames, relative to the data root.
    pub folder: PathBuf,
    /// `files`: the folder with the depth of the inpainted frames, where there is one.
    pub depth_folder: Option<PathBuf>,
    /// `files`: what that depth is.
    pub depth_kind: DepthKind,
    /// What moves is replaced together with this margin: masks end within blurred edges.
    pub margin_px: u32,
    /// `propagate`: at most so many views are looked into, evenly spread over the training views.
    pub max_sources: usize,
}

/// Where filled pixels come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FillSource {
    /// Views that see what is hidden here.
    #[default]
    Propagate,
    /// A video inpainter.
    Files,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: FillSource::Propagate,
            folder: PathBuf::new(),
            depth_folder: None,
            depth_kind: DepthKind::Z,
            margin_px: 2,
            max_sources: 48,
        }
    }
}

impl Params {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == FillSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let depth_folder = self.depth_folder.as_deref();
        let checks = [
            (files && self.folder.as_os_str().is_empty(), "folder", "no folder", "folder = \"priors/scene/inpaint\""),
            (!relative(&self.folder), "folder", "the folder must lie below the data root", "use a relative path"),
            (
                !depth_folder.is_none_or(relative),
                "depth_folder",
                "the folder must lie below the data root",
                "use a relative path",
            ),
            (
                !files && (!self.folder.as_os_str().is_empty() || depth_folder.is_some()),
                "folder",
                "no folder is read",
                "set source = \"files\", or remove the folders",
            ),
            (self.max_sources == 0, "max_sources", "must be at least 1", "48"),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
