//! Schedules: phases and learning rates.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};

/// One phase of a training: it begins with a fresh optimizer and ends with a model state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Phase {
    /// The name, a key of [`Shared::iterations`](crate::shared::Shared::iterations), e.g. `coarse`.
    pub name: &'static str,
    /// Optimizer steps.
    pub iterations: u64,
}

/// The phase before `fine`: nothing moves.
pub(crate) const COARSE: &str = "coarse";
/// The phase after `coarse`: all tensors are trained.
pub(crate) const FINE: &str = "fine";
/// The phase before `all`: the Gaussians are trained as a static scene.
pub(crate) const WARM_UP: &str = "warm-up";
/// The phase before `dynamic`: the static layer is trained.
pub(crate) const STATIC: &str = "static";
/// The phases that train a static scene before a motion model and seeds.
pub(crate) const WARM_UPS: [&str; 3] = [COARSE, WARM_UP, STATIC];

/// A rate that decays log-linearly from `start` to `end` and stays there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LogLinear {
    /// The rate at step 0.
    pub start: f64,
    /// The rate from step `steps` on.
    pub end: f64,
    /// Length of the decay.
    pub steps: u64,
}

impl LogLinear {
    /// A constant rate.
    pub(crate) fn constant(rate: f64) -> Self {
        Self { start: rate, end: rate, steps: 1 }
    }

    /// exp((1 − u)·ln start + u·ln end) with u = min(step / steps, 1).
    pub(crate) fn at(&self, step: u64) -> f64 {
        if self.start == self.end {
            return self.start;
        }
        let u = (step as f64 / self.steps.max(1) as f64).min(1.0);
        ((1.0 - u) * self.start.ln() + u * self.end.ln()).exp()
    }

    /// Multiplies both ends by `factor`.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        Self { start: self.start * factor, end: self.end * factor, ..*self }
    }

    /// Stretches the decay to `factor` times as many steps.
    pub(crate) fn stretched(&self, factor: f64) -> Self {
        Self { steps: stretch(self.steps, factor), ..*self }
    }

    /// The remaining decay after this many steps.
    pub(crate) fn after(&self, steps: u64) -> Self {
        Self { start: self.at(steps), end: self.end, steps: self.steps.saturating_sub(steps).max(1) }
    }
}

impl Table for LogLinear {
    fn check(&self) -> Checks {
        Checks::default().rates(fields!(self, start, end)).at_least_one(fields!(self, steps))
    }
}

/// `steps` times `factor`, rounded; at least 1 unless `steps` is 0.
pub(crate) fn stretch(steps: u64, factor: f64) -> u64 {
    ((steps as f64 * factor).round() as u64).max(steps.min(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decay_has_the_rates_of_its_ends_and_middle() {
        let decay = LogLinear { start: 1e-2, end: 1e-4, steps: 100 };
        for (step, expected) in [(0, 1e-2), (50, 1e-3), (100, 1e-4), (1000, 1e-4)] {
            assert!((decay.at(step) / expected - 1.0).abs() <= 1e-12, "step {step}: {}", decay.at(step));
        }
        assert_eq!(LogLinear::constant(0.05).at(7), 0.05);
        assert!((decay.stretched(0.5).at(25) / 1e-3 - 1.0).abs() <= 1e-12);
    }

    #[test]
    fn the_remaining_decay_continues_the_whole() {
        let decay = LogLinear { start: 1e-2, end: 1e-4, steps: 100 };
        for (left_at, step) in [(30, 20), (30, 70), (30, 500), (0, 50), (100, 3), (200, 3)] {
            let (rest, whole) = (decay.after(left_at).at(step), decay.at(left_at + step));
            assert!((rest / whole - 1.0).abs() <= 1e-12, "left at {left_at}, step {step}: {rest} instead of {whole}");
        }
    }

    #[test]
    fn stretching_never_rounds_to_zero() {
        assert_eq!(stretch(0, 0.5), 0);
        assert_eq!(stretch(1, 0.01), 1);
        assert_eq!(stretch(1000, 0.35), 350);
    }
}
