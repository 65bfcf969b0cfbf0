//! Recipe settings of Phys4DGS.

use serde::{Deserialize, Deserializer, Serialize};

use crate::bases::hexplane::HexplaneSettings;
use crate::check::{Checks, Table, fields};
use crate::schedule::LogLinear;
use crate::shared::over_defaults;

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Phys4dgsSettings {
    /// The field, the network and their training.
    #[serde(deserialize_with = "field_over_defaults")]
    pub field: HexplaneSettings,
    /// Weights of the physical losses.
    pub weights: Weights,
    /// Iterations of `fine` between which the weights grow from 0 to their values; before that, the motion is noise.
    pub ramp: [u64; 2],
    /// Motion is compared with flow in every n-th step, with n times its weight, because it needs one more render.
    pub flow_interval: u64,
    /// Accelerations and jerks are compared in every n-th step, with n times their weights, because they need three
    /// more evaluations of the field and up to four more renders. A multiple of `flow_interval`.
    pub higher_order_interval: u64,
    /// Share of the Gaussians that one step compares.
    pub sample_share: f64,
    /// Maximum number of Gaussians that one step compares.
    pub sample_max: usize,
    /// Minimum coverage of a pixel by a render; below it, the depth is undefined and the pixel is not observed.
    pub min_coverage: f64,
    /// Weight of observed motion along the viewing ray relative to that across it, 0 to 1: it is the difference of two
    /// rendered depths and thus far noisier. 1 is eq 2 as printed.
    pub depth_trust: f64,
    /// Flow that differs from the motion by more than this many times the view's median observed displacement has a
    /// constant gradient (Huber 1964).
    pub flow_outlier: f64,
}

/// Weights of the physical losses; lengths are in motion units, times in frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Weights {
    /// λ_v of eq 3, velocity.
    pub velocity: f64,
    /// λ_t of eq 10, slow change of velocity.
    pub temporal: f64,
    /// λ_d of eq 5, displacement.
    pub displacement: f64,
    /// λ·α_gt of eqs 4 and 5, exact displacement.
    pub true_displacement: f64,
    /// λ_a of eq 8, acceleration.
    pub acceleration: f64,
    /// λ_j of eq 9, jerk.
    pub jerk: f64,
    /// β = γ of eqs 3, 5, 8 and 9, relative to α = 1: the weight of flow against the model's own motion.
    pub flow: f64,
}

/// The paper's network rates decay to a tenth of the initial value; those in the 4DGaussians code decay to a hundredth.
fn field() -> HexplaneSettings {
    HexplaneSettings {
        plane_rate: LogLinear { start: 1.6e-3, end: 1.6e-4, steps: 20_000 },
        network_rate: LogLinear { start: 1.6e-4, end: 1.6e-5, steps: 20_000 },
        ..HexplaneSettings::default()
    }
}

fn field_over_defaults<'de, D: Deserializer<'de>>(deserializer: D) -> Result<HexplaneSettings, D::Error> {
    over_defaults(&field(), deserializer)
}

impl Default for Phys4dgsSettings {
    fn default() -> Self {
        Self {
            field: field(),
            weights: Weights::default(),
            ramp: [1000, 3000],
            flow_interval: 2,
            higher_order_interval: 8,
            sample_share: 0.2,
            sample_max: 20_000,
            min_coverage: 0.5,
            depth_trust: 0.2,
            flow_outlier: 3.0,
        }
    }
}

/// λ_v, λ_t, λ_d, λ_a and λ_j lie in the range that the paper searched, 0.001 to 0.1; the weights were chosen by the
/// sweep in the method's README.
impl Default for Weights {
    fn default() -> Self {
        Self {
            velocity: 0.06,
            temporal: 0.002,
            displacement: 0.06,
            true_displacement: 0.25,
            acceleration: 0.01,
            jerk: 0.01,
            flow: 0.5,
        }
    }
}

impl Phys4dgsSettings {
    /// Small settings with every loss on from the first step at a visible weight, and every Gaussian compared
    /// regardless of opacity.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            field: HexplaneSettings::tiny(),
            weights: Weights {
                velocity: 0.3,
                temporal: 0.2,
                displacement: 0.2,
                true_displacement: 0.4,
                acceleration: 0.1,
                jerk: 0.05,
                flow: 0.5,
            },
            ramp: [0, 0],
            flow_interval: 1,
            higher_order_interval: 1,
            sample_share: 1.0,
            min_coverage: 0.01,
            ..Self::default()
        }
    }
}

impl Table for Phys4dgsSettings {
    fn check(&self) -> Checks {
        let is_multiple = self.higher_order_interval.is_multiple_of(self.flow_interval.max(1));
        let has_share = self.sample_share > 0.0 && self.sample_share <= 1.0;
        Checks::default()
            .table("field", &self.field)
            .require("field.heads.position", self.field.heads.position, "must be true: velocities need it")
            .not_negative(fields!(self, weights.velocity, weights.temporal, weights.displacement, weights.flow))
            .not_negative(fields!(self, weights.true_displacement, weights.acceleration, weights.jerk))
            .require("ramp", self.ramp[0] <= self.ramp[1], "must not end before it begins")
            .at_least_one(fields!(self, flow_interval, higher_order_interval))
            .require("higher_order_interval", is_multiple, "must be a multiple of flow_interval")
            .require("sample_share", has_share, "must be in (0, 1]")
            .at_least_one(fields!(self, sample_max))
            .open_shares(fields!(self, min_coverage))
            .shares(fields!(self, depth_trust))
            .positive(fields!(self, flow_outlier))
    }
}
