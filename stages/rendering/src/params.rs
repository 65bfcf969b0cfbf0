//! What a recipe may say about rendering.

use scene::Split;
use serde::{Deserialize, Serialize};

/// The parameters of one rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderingParams {
    /// Which of the capture's views are rendered.
    pub split: Split,
    /// Whether coverage, depth, velocity and flow of the surfaces are written too, and semantic features and the relevancy
    /// of prompts where the model has them.
    pub maps: Maps,
}

/// When surfaces and semantics are rendered beside colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Maps {
    /// For views of which the capture knows what they can be measured by: surfaces by exact maps, semantics by labels.
    #[default]
    Known,
    /// For every view.
    All,
    /// For none.
    None,
}

impl Default for RenderingParams {
    fn default() -> Self {
        Self { split: Split::Test, maps: Maps::Known }
    }
}
