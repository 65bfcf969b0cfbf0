//! The table `initial_points`.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, MAX_GAUSSIANS, Table, fields};

/// The points of the first Gaussians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct InitialPoints {
    /// The source of the points.
    pub from: PointSource,
    /// Number of random points.
    pub random_count: usize,
    /// Maximum number of the capture's points; beyond it, evenly chosen ones are used.
    pub max_count: usize,
}

/// A source of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum PointSource {
    /// The capture's points if it has any, otherwise random ones.
    Auto,
    /// The capture's points.
    Capture,
    /// Uniform in the capture's bounds, mid-grey.
    Random,
}

impl Default for InitialPoints {
    fn default() -> Self {
        Self { from: PointSource::Auto, random_count: 100_000, max_count: 200_000 }
    }
}

impl Table for InitialPoints {
    fn check(&self) -> Checks {
        Checks::default().counts(MAX_GAUSSIANS, fields!(self, random_count, max_count))
    }
}
