//! The tables `harmonics`, `loss` and `curve`: colours of renders, their comparison with images, and the quality curve.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};

/// Maximum points of a curve: each renders several views, so more points would take longer than the training.
const MAX_POINTS: u64 = 1000;

/// Spherical harmonics: the degree starts at 0 and grows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Harmonics {
    /// The final degree, 0 to 3.
    pub degree: usize,
    /// Iterations between two degrees.
    pub interval: u64,
}

/// The photometric loss (1 − λ)·L1 + λ·(1 − SSIM).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Loss {
    /// λ; 0 skips SSIM altogether.
    pub lambda_dssim: f64,
}

/// The quality curve: measurements on a few validation views, during which the training clock is stopped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Curve {
    /// Number of points, denser at the start (quadratic in the iteration); 0: no curve.
    pub points: u64,
    /// Number of validation views, evenly chosen.
    pub views: usize,
}

impl Default for Harmonics {
    fn default() -> Self {
        Self { degree: 3, interval: 1000 }
    }
}

impl Default for Loss {
    fn default() -> Self {
        Self { lambda_dssim: 0.2 }
    }
}

impl Default for Curve {
    fn default() -> Self {
        Self { points: 40, views: 5 }
    }
}

impl Table for Harmonics {
    fn check(&self) -> Checks {
        Checks::default().at_most(3, fields!(self, degree)).at_least_one(fields!(self, interval))
    }
}

impl Table for Loss {
    fn check(&self) -> Checks {
        Checks::default().shares(fields!(self, lambda_dssim))
    }
}

impl Table for Curve {
    fn check(&self) -> Checks {
        let checks = Checks::default().at_most(MAX_POINTS, fields!(self, points));
        checks.require("views", self.points == 0 || self.views > 0, "must be at least 1")
    }
}
