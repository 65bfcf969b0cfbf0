//! The table `temporal_pruning`.

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use super::check::Checks;

/// Maximum views of a measurement; their renders are a cost of every round.
pub(super) const MAX_VIEWS: usize = 1024;

/// The effect `temporal-pruning`: rounds that remove the Gaussians to which the images of sampled times are least
/// sensitive (Tu et al. 2025, SpeeDe3DGS). Iterations are those of density control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TemporalPruning {
    /// No rounds before this iteration.
    pub from: u64,
    /// Iterations between two rounds; stretched by the schedule scale.
    pub interval: u64,
    /// Share of the Gaussians that a round removes while density control adds others.
    pub share: f64,
    /// Share of the Gaussians that a round removes afterwards.
    pub late_share: f64,
    /// Training views on which a round measures, evenly over time.
    pub views: usize,
}

impl Default for TemporalPruning {
    fn default() -> Self {
        Self { from: 6000, interval: 3000, share: 0.3, late_share: 0.15, views: 32 }
    }
}

impl TemporalPruning {
    pub(super) fn problems(&self) -> Vec<ParamProblem> {
        Checks::of("temporal_pruning")
            .at_least_one("from", self.from)
            .at_least_one("interval", self.interval)
            .open_share("share", self.share)
            .open_share("late_share", self.late_share)
            .require("views", (1..=MAX_VIEWS).contains(&self.views), format!("must be 1 to {MAX_VIEWS}"))
            .problems
    }
}
