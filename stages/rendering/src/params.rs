//! What a recipe may say about rendering.

use scene::Split;
use serde::{Deserialize, Serialize};

/// The parameters of one rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderingParams {
    /// Which of the capture's views are rendered.
    pub split: Split,
    /// Whether depth is written too (EXR, Σ z·α·T, scene units).
    pub depth: bool,
}

impl Default for RenderingParams {
    fn default() -> Self {
        Self { split: Split::Test, depth: false }
    }
}
