//! How far a trial goes: asynchronous successive halving (Li et al. 2020).

use std::collections::BTreeMap;

/// The rungs of a search, and the rule by which trials climb them.
#[derive(Clone, Debug, PartialEq)]
pub struct Halving {
    /// One of this number of trials of a rung continues.
    pub reduction: usize,
    /// The number of rungs; with 1, every trial is completed at once.
    pub rungs: usize,
}

/// What a search does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Start a new trial at the lowest rung.
    Start,
    /// Continue this trial up to this rung.
    Continue {
        /// The trial's number.
        trial: usize,
        /// The rung to reach.
        rung: usize,
    },
    /// All trials are as far as they get.
    Done,
}

/// Trial → rung → objective (larger is better); `None` for a trial that failed there.
pub type Reached = BTreeMap<usize, BTreeMap<usize, Option<f64>>>;

impl Halving {
    /// The share of its steps after which a trial pauses at a rung; 1 for the last one, which completes it.
    pub fn share(&self, rung: usize) -> f64 {
        let above = self.rungs.saturating_sub(1).saturating_sub(rung);
        (self.reduction as f64).powi(-i32::try_from(above).unwrap_or(i32::MAX))
    }

    /// What comes next, if at most `trials` are started. Trials that can climb come before new ones, highest rungs first, so
    /// that an interrupted search has complete trials.
    pub fn next(&self, reached: &Reached, trials: usize) -> Next {
        for rung in (0..self.rungs.saturating_sub(1)).rev() {
            let mut at_rung: Vec<(usize, f64)> =
                reached.iter().filter_map(|(trial, rungs)| Some((*trial, (*rungs.get(&rung)?)?))).collect();
            // Failed trials count, so that a rung of failures does not block the others.
            let count = reached.values().filter(|rungs| rungs.contains_key(&rung)).count();
            at_rung.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let mut best = at_rung.iter().take(count / self.reduction.max(1));
            let waits = |(trial, _): &&(usize, f64)| !reached[trial].contains_key(&(rung + 1));
            if let Some((trial, _)) = best.find(waits) {
                return Next::Continue { trial: *trial, rung: rung + 1 };
            }
        }
        if reached.len() < trials { Next::Start } else { self.complete_one(reached) }
    }

    /// Continues the best trial of the highest rung if no trial is completed: too few trials for the rule still have a best
    /// one.
    fn complete_one(&self, reached: &Reached) -> Next {
        let at = |rung: usize| reached.iter().filter_map(move |(trial, rungs)| Some((*trial, (*rungs.get(&rung)?)?)));
        let highest = (0..self.rungs).rev().find(|&rung| at(rung).next().is_some());
        let is_failed = |rung: usize| reached.values().any(|rungs| rungs.get(&rung) == Some(&None));
        match highest.filter(|&rung| rung + 1 < self.rungs && !is_failed(rung + 1)) {
            Some(rung) => match at(rung).max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))) {
                Some((trial, _)) => Next::Continue { trial, rung: rung + 1 },
                None => Next::Done,
            },
            None => Next::Done,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a search in which trial `n` reaches the objective `n` at every rung.
    fn search(halving: &Halving, trials: usize) -> Reached {
        let mut reached = Reached::new();
        loop {
            match halving.next(&reached, trials) {
                Next::Start => {
                    let trial = reached.len();
                    reached.insert(trial, BTreeMap::from([(0, Some((trial * 7 % trials) as f64))]));
                }
                Next::Continue { trial, rung } => {
                    let value = reached[&trial][&0];
                    assert!(reached.get_mut(&trial).unwrap().insert(rung, value).is_none(), "repeated");
                }
                Next::Done => return reached,
            }
        }
    }

    #[test]
    fn shares_grow_by_the_reduction() {
        let halving = Halving { reduction: 3, rungs: 3 };
        let shares: Vec<f64> = (0..3).map(|rung| (halving.share(rung) * 9.0).round()).collect();
        assert_eq!(shares, [1.0, 3.0, 9.0]);
        assert_eq!(Halving { reduction: 3, rungs: 1 }.share(0), 1.0);
    }

    #[test]
    fn the_best_of_each_rung_climb() {
        let reached = search(&Halving { reduction: 3, rungs: 3 }, 27);
        let at = |rung: usize| reached.values().filter(|rungs| rungs.contains_key(&rung)).count();
        assert_eq!(at(0), 27);
        assert!((9..14).contains(&at(1)) && (3..7).contains(&at(2)), "{} {}", at(1), at(2));
        let best = reached.values().find(|rungs| rungs[&0] == Some(26.0)).unwrap();
        assert_eq!(best.len(), 3, "the best trial is completed");
    }

    #[test]
    fn few_trials_complete_one() {
        let reached = search(&Halving { reduction: 3, rungs: 3 }, 2);
        let lengths: Vec<usize> = reached.values().map(BTreeMap::len).collect();
        assert_eq!(lengths, [1, 3]);
    }

    #[test]
    fn one_rung_completes_every_trial_and_failures_do_not_climb() {
        let halving = Halving { reduction: 3, rungs: 1 };
        assert!(search(&halving, 5).values().all(|rungs| rungs.len() == 1));
        let halving = Halving { reduction: 2, rungs: 2 };
        let failed: Reached = (0..4).map(|trial| (trial, BTreeMap::from([(0, None)]))).collect();
        assert_eq!(halving.next(&failed, 4), Next::Done);
        assert_eq!(halving.next(&failed, 5), Next::Start);
    }
}
