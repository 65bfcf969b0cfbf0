//! How much each loss weighs as training goes on.

use serde::{Deserialize, Serialize};

use crate::schedule::{LogLinear, stretch};

/// The share of the flow's weight that is left where it ends.
const FLOW_LEFT: f64 = 1e-2;

/// Weights of the losses beyond the photometric one, and their schedule in iterations of `fine`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossSettings {
    /// Of the energy-flow loss (λ_flow); lengths are shares of the scene's extent.
    pub flow: f64,
    /// Of the spread of activation windows (λ_reg).
    pub activation: f64,
    /// Of the coherence of neighbours (λ_coh).
    pub coherence: f64,
    /// All of them grow from 0 over so many iterations.
    pub ramp: u64,
    /// From here on the energy-flow loss fades, to a hundredth of its weight …
    pub flow_fades_from: u64,
    /// … here, from where on it is not evaluated.
    pub flow_ends: u64,
}

impl Default for LossSettings {
    fn default() -> Self {
        Self { flow: 0.1, activation: 0.01, coherence: 0.01, ramp: 2000, flow_fades_from: 5000, flow_ends: 10_000 }
    }
}

/// The weights at one iteration; 0 where a loss is not evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    /// λ_flow.
    pub flow: f64,
    /// λ_reg.
    pub activation: f64,
    /// λ_coh.
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

    /// Whether weights and schedule can work.
    pub(crate) fn works(&self) -> bool {
        [self.flow, self.activation, self.coherence].iter().all(|&weight| weight >= 0.0 && weight.is_finite())
            && self.flow_fades_from <= self.flow_ends
    }
}
