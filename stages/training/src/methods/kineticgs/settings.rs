//! Settings specific to KineticGS.

use serde::{Deserialize, Serialize};

use super::neighbors::Neighbors;
use super::weights::LossSettings;
use crate::bases::anchors::{AnchorSettings, DeformationSettings, FieldSettings};
use crate::check::{Checks, Table};
use crate::schedule::LogLinear;

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// Anchors and their networks.
    pub anchors: AnchorSettings,
    /// The deformation fields of particles and Gaussians.
    pub deformation: DeformationSettings,
    /// θ_g: positions of particles move while their window is above this threshold. With 0, as eq 11 is printed, they
    /// always move, because a window is a product of logistic functions and thus positive; with ½, they move within the
    /// window.
    pub gate_threshold: f64,
    /// Whether positions fade in and out with the window like all other attributes, instead of jumping at its borders.
    pub soft_location: bool,
    /// Whether `coarse` also trains on moving pixels, and draws and trains the particles where they start.
    pub coarse_all: bool,
    /// Neighbour search of the coherence loss.
    pub neighbors: Neighbors,
    /// Weights and schedules of the losses.
    pub losses: LossSettings,
    /// Learning rate of the activation network.
    pub activation_rate: LogLinear,
}

impl Default for Settings {
    fn default() -> Self {
        // MoDec-GS reads the field of anchors at eight times, KineticGS at all.
        let particles = FieldSettings { time_resolution: None, ..DeformationSettings::default().anchors };
        Self {
            anchors: AnchorSettings::default(),
            deformation: DeformationSettings { anchors: particles, ..DeformationSettings::default() },
            gate_threshold: 0.0,
            soft_location: false,
            coarse_all: false,
            neighbors: Neighbors::Curve,
            losses: LossSettings::default(),
            activation_rate: LogLinear { start: 2e-3, end: 2e-5, steps: 30_000 },
        }
    }
}

impl Settings {
    /// Small settings with all losses at visible weights from the start, and particles at their seeds, so that views
    /// see them.
    #[cfg(test)]
    pub(super) fn tiny() -> Self {
        Self {
            anchors: AnchorSettings::tiny(),
            deformation: DeformationSettings { zero_heads: true, ..DeformationSettings::tiny() },
            gate_threshold: 0.01,
            losses: LossSettings { flow: 1.0, activation: 0.1, coherence: 0.1, ramp: 0, ..LossSettings::default() },
            ..Self::default()
        }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("anchors", &self.anchors)
            .table("deformation", &self.deformation)
            .require("gate_threshold", (0.0..1.0).contains(&self.gate_threshold), "must be in [0, 1)")
            .table("losses", &self.losses)
            .table("activation_rate", &self.activation_rate)
    }
}
