//! The table `learning_rates`.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};
use crate::schedule::LogLinear;

/// Learning rates of the Gaussians' attributes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LearningRates {
    /// Positions, as a share of the scene's extent; in methods on canonical Gaussians, of 5 units of published constants.
    pub position: LogLinear,
    /// Constant colour.
    pub sh_dc: f64,
    /// All other harmonics.
    pub sh_rest: f64,
    /// Opacity logits.
    pub opacity: f64,
    /// Logarithmic scales.
    pub scale: f64,
    /// Quaternions.
    pub rotation: f64,
}

impl Default for LearningRates {
    fn default() -> Self {
        Self {
            position: LogLinear { start: 1.6e-4, end: 1.6e-6, steps: 30_000 },
            sh_dc: 2.5e-3,
            sh_rest: 1.25e-4,
            opacity: 0.05,
            scale: 5e-3,
            rotation: 1e-3,
        }
    }
}

impl Table for LearningRates {
    fn check(&self) -> Checks {
        let rates = fields!(self, sh_dc, sh_rest, opacity, scale, rotation);
        Checks::default().table("position", &self.position).rates(rates)
    }
}
