//! Parameters of the stage.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::Metric;

/// What to measure, and on which images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricEvaluationParams {
    /// Metrics to compute; all by default.
    pub metrics: BTreeSet<Metric>,
    /// Levels that colours are brought to before they are compared; `round8` by default.
    pub quantise: Quantise,
}

impl Default for MetricEvaluationParams {
    fn default() -> Self {
        Self { metrics: Metric::ALL.into(), quantise: Quantise::Round8 }
    }
}

/// Levels that colours are brought to before they are compared.
///
/// The splatting papers score the 8-bit files that they saved. 8-bit opaque images are the same under each choice;
/// 16-bit images and composited transparency are not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quantise {
    /// To the nearest of 256 levels, halves up (`torchvision.utils.save_image`).
    #[default]
    Round8,
    /// To the next lower of 256 levels (an integer cast, as 4DGaussians composites its truth).
    Trunc8,
    /// As stored.
    None,
}

impl Quantise {
    /// The nearest allowed level of a colour in [0, 1].
    pub fn apply(self, colour: f64) -> f64 {
        // A colour that is a whole level up to rounding error must keep that level under truncation.
        const ROUNDING: f64 = 1e-9;
        match self {
            Self::Round8 => (colour * 255.0 + 0.5).floor() / 255.0,
            Self::Trunc8 => (colour * 255.0 + ROUNDING).floor() / 255.0,
            Self::None => colour,
        }
    }
}
