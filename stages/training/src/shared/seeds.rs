//! The table `seeds`.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, MAX_GAUSSIANS, Table, fields};

/// The Gaussians that the effect `seed-from-masks` adds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Seeds {
    /// Spacing of the seeds in pixels: one seed on every N-th masked pixel of every N-th row of every training view.
    pub pixel_stride: usize,
    /// Maximum number over all views: if there are more, the spacing grows by whole pixels.
    pub max_count: usize,
    /// Depth of the subject relative to that of its surroundings, where only theirs is known. With values near 1,
    /// static Gaussians may cover the subject, because a Gaussian extends in front of its surface.
    pub relative_depth: f64,
    /// Initial opacity.
    pub opacity: f64,
    /// Weight of the mean |render − image| over the moving pixels, relative to the photometric loss, to which it is added.
    pub weight: f64,
    /// Weight of the loss `silhouette`, the mean |weight of the seeds − mask| over all pixels. It keeps the seeds from
    /// explaining errors of the background, and the background from showing the subject. `realtime4dgs` does not have it.
    pub silhouette: f64,
}

impl Default for Seeds {
    fn default() -> Self {
        Self { pixel_stride: 2, max_count: 60_000, relative_depth: 0.97, opacity: 0.7, weight: 0.1, silhouette: 0.4 }
    }
}

impl Table for Seeds {
    fn check(&self) -> Checks {
        Checks::default()
            .at_least_one(fields!(self, pixel_stride))
            .counts(MAX_GAUSSIANS, fields!(self, max_count))
            .open_shares(fields!(self, relative_depth, opacity))
            .not_negative(fields!(self, weight, silhouette))
    }
}
