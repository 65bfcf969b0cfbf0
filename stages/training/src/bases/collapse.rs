//! A guard against pruning that would empty a model.

use serde::{Deserialize, Serialize};

/// A round of pruning must leave this share of the largest population so far: legitimate rounds leave several per cent.
const MIN_SHARE: f64 = 1.0 / 200.0;

/// Refuses rounds of pruning that would empty a population, and all later ones of the phase. Without it, a scene in which most
/// pixels equal the background drives all opacities below the threshold of pruning, and no Gaussian is left to train.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct CollapseGuard {
    /// The largest population of the phase so far.
    most: usize,
    /// Whether a round has been refused.
    closed: bool,
}

impl CollapseGuard {
    /// Whether a round was refused; then nothing may be pruned any more.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Refuses to prune a population to the rows of `keep` if that would empty it, and every later round. Returns what
    /// the report says about the refusal; `None` if the round may prune.
    pub(crate) fn refuses(&mut self, population: &str, iteration: u64, keep: &[bool]) -> Option<String> {
        self.most = self.most.max(keep.len());
        let left = keep.iter().filter(|&&keep| keep).count();
        self.closed |= left == 0 || (left as f64) < MIN_SHARE * self.most as f64;
        self.closed.then(|| {
            format!(
                "pruning stopped at iteration {iteration}: it would have left {left} of {} {population} (at most {} \
                 before). Most pixels may equal the background, or the initial points may lie outside the scene",
                keep.len(),
                self.most
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mask that keeps the first `left` of `count` rows.
    fn keeping(left: usize, count: usize) -> Vec<bool> {
        (0..count).map(|row| row < left).collect()
    }

    /// Whether a guard lets a round keep the first `left` of `count` rows.
    fn allows(guard: &mut CollapseGuard, left: usize, count: usize) -> bool {
        guard.refuses("gaussians", 70, &keeping(left, count)).is_none()
    }

    #[test]
    fn rounds_that_leave_almost_nothing_are_refused_for_good() {
        let mut guard = CollapseGuard::default();
        assert!(allows(&mut guard, 50, 1000) && allows(&mut guard, 5, 50), "five of a thousand may stay");
        let notice = guard.refuses("gaussians", 70, &keeping(4, 5)).expect("four of at most 1000");
        assert!(notice.contains("left 4 of 5 gaussians (at most 1000 before)"), "{notice}");
        assert!(guard.is_closed() && !allows(&mut guard, 5, 5), "the guard stays closed");
    }

    #[test]
    fn small_models_may_shrink_but_not_vanish() {
        let mut guard = CollapseGuard::default();
        assert!(allows(&mut guard, 1, 4) && allows(&mut guard, 1, 1));
        assert!(!allows(&mut guard, 0, 1));
    }
}
