//! The parameters of the stage.

use std::collections::BTreeMap;

use scene::Split;
use serde::{Deserialize, Serialize};

/// The parameters of a rendering job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderingParams {
    /// The split whose views are rendered.
    pub split: Split,
    /// When to write surfaces (coverage, depth, velocity and flow) and semantics (features and the relevancy of prompts,
    /// if the model has them).
    pub maps: Maps,
    /// Values that replace tensors of the model, by name, e.g. `"mixing.shares" = [0, 0]`. They measure the
    /// contribution of a part of a trained model without a second training.
    pub tensors: BTreeMap<String, Vec<f32>>,
}

/// The views whose surfaces and semantics are rendered next to their colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Maps {
    /// Views with ground truth to measure against: exact maps or labels for surfaces, labels for semantics.
    #[default]
    Known,
    /// Every view.
    All,
    /// No view.
    None,
}

impl Default for RenderingParams {
    fn default() -> Self {
        Self { split: Split::Test, maps: Maps::Known, tensors: BTreeMap::new() }
    }
}
