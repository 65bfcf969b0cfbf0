//! The table `temporal_pruning`.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};

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

impl Table for TemporalPruning {
    fn check(&self) -> Checks {
        Checks::default()
            .at_least_one(fields!(self, from, interval))
            .open_shares(fields!(self, share, late_share))
            .counts(MAX_VIEWS, fields!(self, views))
    }
}
