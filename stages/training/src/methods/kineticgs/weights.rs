//! Schedules of the loss weights.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};
use crate::schedule::{LogLinear, stretch};

/// Remaining share of the flow's weight at its last iteration.
const FLOW_LEFT: f64 = 1e-2;

/// Weights of the losses in addition to the photometric one, and their schedule in iterations of `fine`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossSettings {
    /// Weight of the energy-flow loss (λ_flow), which measures lengths in scene extents.
    pub flow: f64,
    /// Weight of the regularisation that spreads the activation windows (λ_reg).
    pub activation: f64,
    /// Weight of the coherence of neighbours (λ_coh).
    pub coherence: f64,
    /// Number of iterations over which all weights grow from 0.
    pub ramp: u64,
    /// Iteration at which the energy-flow loss begins to decay, to a hundredth of its weight at `flow_ends`.
    pub flow_fades_from: u64,
    /// Iteration after which the energy-flow loss is not evaluated.
    pub flow_ends: u64,
}

impl Default for LossSettings {
    fn default() -> Self {
        Self { flow: 1.0, activation: 1e-4, coherence: 1e-3, ramp: 2000, flow_fades_from: 5000, flow_ends: 10_000 }
    }
}

/// Loss weights at one iteration; 0 for a loss that is not evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    /// λ_flow, of the energy-flow loss.
    pub flow: f64,
    /// λ_reg, of the spread of activation windows.
    pub activation: f64,
    /// λ_coh, of the coherence of neighbours.
    pub coherence: f64,
}

impl LossSettings {
    /// The weights at an iteration of `fine`, counted from 1, with the schedule stretched by `schedule_scale`.
    pub(crate) fn at(&self, iteration: u64, schedule_scale: f64) -> Weights {
        let [ramp, fades_from, ends] =
            [self.ramp, self.flow_fades_from, self.flow_ends].map(|at| stretch(at, schedule_scale));
        let grown = if ramp == 0 { 1.0 } else { (iteration as f64 / ramp as f64).min(1.0) };
        let fade = LogLinear { start: 1.0, end: FLOW_LEFT, steps: ends.saturating_sub(fades_from) };
        let left = if iteration >= ends { 0.0 } else { fade.at(iteration.saturating_sub(fades_from)) };
        Weights {
            flow: grown * left * self.flow,
            activation: grown * self.activation,
            coherence: grown * self.coherence,
        }
    }
}

impl Table for LossSettings {
    fn check(&self) -> Checks {
        let checks = Checks::default().not_negative(fields!(self, flow, activation, coherence));
        checks.require("flow_ends", self.flow_ends >= self.flow_fades_from, "must be at least flow_fades_from")
    }
}
