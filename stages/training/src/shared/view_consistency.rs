//! The table `view_consistency`.

use serde::{Deserialize, Serialize};

use super::temporal_pruning::MAX_VIEWS;
use crate::check::{Checks, Table, fields};

/// The effect `view-consistent-density`: a Gaussian grows only if it shows high errors, on average over sampled views (Ren et
/// al. 2025, FastGS). Iterations are those of density control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ViewConsistency {
    /// Training views on which a round measures, evenly over time.
    pub views: usize,
    /// The error of a pixel is high above this share of the way from the smallest to the largest error of its view.
    pub high_error: f64,
    /// A round clones and splits only Gaussians with at least this many pixels of high error, in images of the full size: the
    /// sum of the Gaussian's weights in these pixels, mean over the sampled views in which it is not hidden.
    pub min_error_px: f64,
    /// Iterations between two rounds that prune after the end of cloning and splitting, until as many iterations have passed
    /// again; stretched by the schedule scale.
    pub late_interval: u64,
    /// Gaussians less opaque than this are pruned in these rounds.
    pub late_min_opacity: f64,
    /// Gaussians are pruned in these rounds if their error, weighted by the loss of each view, is above this share of the
    /// largest.
    pub late_max_error: f64,
}

impl Default for ViewConsistency {
    fn default() -> Self {
        Self {
            views: 10,
            high_error: 0.1,
            min_error_px: 1.0,
            late_interval: 3000,
            late_min_opacity: 0.05,
            late_max_error: 0.9,
        }
    }
}

impl Table for ViewConsistency {
    fn check(&self) -> Checks {
        Checks::default()
            .at_least_one(fields!(self, late_interval))
            .counts(MAX_VIEWS, fields!(self, views))
            .not_negative(fields!(self, min_error_px))
            .open_shares(fields!(self, high_error, late_min_opacity, late_max_error))
    }
}
