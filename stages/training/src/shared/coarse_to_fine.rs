//! The table `coarse_to_fine`: the resolution schedule of the effect of that name.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table};

/// Maximum factor by which images are reduced; in smaller images, too many Gaussians fall into one tile.
pub(crate) const MAX_REDUCTION: usize = 8;
/// Maximum share of the steps on smaller images, so that every training ends on images of the full size.
const MAX_SHARE: f64 = 0.9;

/// The effect `coarse-to-fine`: early steps train on smaller images (Chen et al. 2025, DashGaussian; a schedule of equal
/// parts here, where the paper derives the parts from the spectrum of the images).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct CoarseToFine {
    /// Factor by which the first steps divide width and height. It falls to 1 in equal numbers of steps.
    pub reduction: usize,
    /// Share of all steps of the training after which images have their full size.
    pub until: f64,
    /// Whether the number of Gaussians is limited by the paper's budget, which grows with the size of the images and with the
    /// number of Gaussians that density control would add. It also applies to images of the full size.
    pub limits_growth: bool,
}

impl Default for CoarseToFine {
    fn default() -> Self {
        Self { reduction: 4, until: 0.5, limits_growth: true }
    }
}

impl CoarseToFine {
    /// The reduction in step `step` of `total`, counted from 1 over all phases; 1 is the full size.
    pub(crate) fn reduction_at(&self, step: u64, total: u64) -> usize {
        let share = step.saturating_sub(1) as f64 / (self.until * total as f64);
        let passed = (share * (self.reduction - 1) as f64) as usize;
        self.reduction.saturating_sub(passed).max(1)
    }

    /// The mean over a training of the share of its pixels that a step renders.
    pub(crate) fn mean_pixel_share(&self) -> f64 {
        let small: f64 = (2..=self.reduction).map(|reduction| (reduction as f64).powi(-2)).sum();
        1.0 - self.until + self.until * small / (self.reduction - 1) as f64
    }
}

impl Table for CoarseToFine {
    fn check(&self) -> Checks {
        let few = (2..=MAX_REDUCTION).contains(&self.reduction);
        let early = self.until > 0.0 && self.until <= MAX_SHARE;
        let checks = Checks::default().require("reduction", few, format!("must be 2 to {MAX_REDUCTION}"));
        checks.require("until", early, format!("must be in (0, {MAX_SHARE}]"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_grow_in_equal_parts_to_the_full_size() {
        let schedule = CoarseToFine { reduction: 4, until: 0.6, ..CoarseToFine::default() };
        let of = |step| schedule.reduction_at(step, 1000);
        let ends: Vec<usize> = [1, 200, 201, 400, 401, 600, 601, 1000].map(of).to_vec();
        assert_eq!(ends, [4, 4, 3, 3, 2, 2, 1, 1]);
        let pixels: f64 = (1..=1000).map(|step| (of(step) as f64).powi(-2)).sum();
        assert!((pixels / 1000.0 - schedule.mean_pixel_share()).abs() <= 1e-12);
        assert_eq!(schedule.reduction_at(1, 1), 4, "a single step is an early one");
    }
}
