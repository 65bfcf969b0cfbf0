//! The table `seeds`.

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use super::check::Checks;

/// The Gaussians that the effect `seed-from-masks` adds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Seeds {
    /// Spacing in pixels: one on every N-th masked pixel of every N-th row of every training view.
    pub pixel_stride: usize,
    /// Maximum number over all views, evenly chosen.
    pub max_count: usize,
    /// Initial opacity.
    pub opacity: f64,
    /// Weight of the mean |render − image| over the moving pixels, in addition to the photometric loss.
    pub weight: f64,
}

impl Default for Seeds {
    fn default() -> Self {
        Self { pixel_stride: 2, max_count: 60_000, opacity: 0.7, weight: 0.1 }
    }
}

impl Seeds {
    pub(super) fn problems(&self) -> Vec<ParamProblem> {
        Checks::of("seeds")
            .at_least_one("pixel_stride", self.pixel_stride as u64)
            .gaussians("max_count", self.max_count)
            .open_share("opacity", self.opacity)
            .require("weight", self.weight >= 0.0 && self.weight.is_finite(), "must not be negative")
            .problems
    }
}
