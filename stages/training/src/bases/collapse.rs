//! A guard against pruning that would empty a model.

use serde::{Deserialize, Serialize};

/// A round of pruning must leave this share of the largest population so far: legitimate rounds leave several per cent.
const MIN_SHARE: f64 = 1.0 / 200.0;

/// Refuses rounds of pruning that would empty a population, and all later ones. Without it, a scene in which most pixels
/// equal the background drives all opacities below the threshold of pruning, and no Gaussian is left to train.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct CollapseGuard {
    /// The largest population so far.
    most: usize,
    /// Whether a round has been refused.
    closed: bool,
}

impl CollapseGuard {
    /// Whether a round was refused, so that nothing may be pruned any more.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether a round may prune a population to the rows of `keep`; a refusal closes the guard.
    pub(crate) fn allows(&mut self, keep: &[bool]) -> bool {
        self.most = self.most.max(keep.len());
        let left = keep.iter().filter(|&&keep| keep).count();
        self.closed |= left == 0 || (left as f64) < MIN_SHARE * self.most as f64;
        !self.closed
    }

    /// What the report says about the refused round.
    pub(crate) fn notice(&self, population: &str, iteration: u64, keep: &[bool]) -> String {
        let left = keep.iter().filter(|&&keep| keep).count();
        format!(
            "pruning stopped at iteration {iteration}: it would have left {left} of {} {population} (at most {} before). \
             Most pixels may equal the background, or the initial points may lie \
             outside of the scene",
            keep.len(),
            self.most
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mask that keeps the first `left` of `count` rows.
    fn keeping(left: usize, count: usize) -> Vec<bool> {
        (0..count).map(|row| row < left).collect()
    }

    #[test]
    fn rounds_that_leave_almost_nothing_are_refused_for_good() {
        let mut guard = CollapseGuard::default();
        assert!(guard.allows(&keeping(50, 1000)) && guard.allows(&keeping(5, 50)), "five of a thousand may stay");
        assert!(!guard.allows(&keeping(4, 5)), "four of at most 1000");
        assert!(guard.is_closed() && !guard.allows(&keeping(5, 5)), "the guard stays closed");
        assert!(guard.notice("gaussians", 70, &keeping(4, 5)).contains("left 4 of 5 gaussians (at most 1000 before)"));
    }

    #[test]
    fn small_models_may_shrink_but_not_vanish() {
        let mut guard = CollapseGuard::default();
        assert!(guard.allows(&keeping(1, 4)) && guard.allows(&keeping(1, 1)));
        assert!(!guard.allows(&keeping(0, 1)));
    }
}
