//! How many Gaussians a resolution schedule allows (Chen et al. 2025, DashGaussian, section 4.3).

use serde::{Deserialize, Serialize};

use crate::method::Detail;

/// The first estimate of the final number, as a multiple of the initial one (published code).
const FIRST_ESTIMATE: f64 = 5.0;
/// Decay of the estimate in a round (γ of the paper; η is 1).
const DECAY: f64 = 0.98;

/// An estimate of the final number of Gaussians, from the number that density control would add in each round.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct GrowthBudget {
    initial: f64,
    last: f64,
}

impl GrowthBudget {
    /// The budget of a population before its first round.
    pub(crate) fn new(count: usize) -> Self {
        Self { initial: count as f64, last: FIRST_ESTIMATE * count as f64 }
    }

    /// The number of Gaussians allowed after a round that would add `wanted`: P₀ + (P − P₀) / r^(2 − u) at reduction r and
    /// progress u, after the estimate P ← max(P, γ·P + wanted).
    pub(crate) fn allows(&mut self, wanted: usize, detail: Detail) -> usize {
        self.last = self.last.max(DECAY * self.last + wanted as f64);
        let share = (detail.reduction as f64).powf(detail.progress - 2.0);
        (self.initial + (self.last - self.initial) * share) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_budget_grows_with_the_size_of_images_and_with_demand() {
        let detail = |reduction, progress| Detail { reduction, progress, limits_growth: true };
        let mut budget = GrowthBudget::new(1000);
        assert_eq!(budget.allows(0, detail(4, 0.0)), 1250);
        assert_eq!(budget.allows(100, detail(2, 0.5)), 1000 + (4000.0 * 2.0_f64.powf(-1.5)) as usize);
        assert_eq!(budget.allows(0, detail(1, 0.5)), 5000);
        assert_eq!(budget.allows(600, detail(1, 0.5)), 5500, "0.98 of 5000 and 600");
    }
}
