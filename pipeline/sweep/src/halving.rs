//! How long a trial trains: asynchronous successive halving (Li et al. 2020).

use std::collections::BTreeMap;

/// The rungs of a search, and the rule by which trials are promoted.
#[derive(Clone, Debug, PartialEq)]
pub struct Halving {
    /// The reduction factor N: the best 1/N of the trials of a rung continue.
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
    /// Wait: other processes work on trials, whose results may allow more work.
    Wait,
    /// No trial can continue.
    Done,
}

/// Trial → rung → objective (larger is better); `None` for a trial that failed there.
pub type Reached = BTreeMap<usize, BTreeMap<usize, Option<f64>>>;

/// The trials of a search so far.
#[derive(Clone, Copy, Debug)]
pub struct Trials<'a> {
    /// The results of the trials.
    pub reached: &'a Reached,
    /// The number of trials that have a point; some may have no result yet.
    pub started: usize,
    /// The number of trials that may be started.
    pub most: usize,
}

impl Halving {
    /// The share of its last phase after which a training pauses at a rung; 1 for the last rung, which completes it.
    pub fn share(&self, rung: usize) -> f64 {
        let above = self.rungs.saturating_sub(1).saturating_sub(rung);
        (self.reduction as f64).powi(-i32::try_from(above).unwrap_or(i32::MAX))
    }

    /// The mean share of its steps for which a trial trains, if exactly one of `reduction` trials continues at each rung.
    pub fn mean_share(&self) -> f64 {
        let rungs = 0..self.rungs.max(1);
        let before = |rung: usize| if rung == 0 { 0.0 } else { self.share(rung - 1) };
        let arrive = |rung: usize| (self.reduction as f64).powi(-i32::try_from(rung).unwrap_or(i32::MAX));
        rungs.map(|rung| arrive(rung) * (self.share(rung) - before(rung))).sum()
    }

    /// The next step. Trials that can be promoted come before new ones, highest rungs first, so that an interrupted
    /// search has complete trials. `take` claims the work on a trial up to a rung, and fails if another process holds
    /// it.
    pub fn next(&self, trials: &Trials<'_>, mut take: impl FnMut(usize, usize) -> bool) -> Next {
        let mut is_waiting = false;
        let mut try_take = |trial: usize, rung: usize| {
            let is_free = take(trial, rung);
            is_waiting |= !is_free;
            is_free.then_some(Next::Continue { trial, rung })
        };
        for rung in (0..self.rungs.saturating_sub(1)).rev() {
            let mut climbing = self.climbing(trials.reached, rung).into_iter();
            if let Some(next) = climbing.find_map(|trial| try_take(trial, rung + 1)) {
                return next;
            }
        }
        let begun = |trial: &usize| trials.reached.contains_key(trial);
        if let Some(next) = (0..trials.started).filter(|trial| !begun(trial)).find_map(|trial| try_take(trial, 0)) {
            return next;
        }
        if trials.started < trials.most {
            return Next::Start;
        }
        if is_waiting {
            return Next::Wait;
        }
        match self.last_resort(trials.reached) {
            Some((trial, rung)) if take(trial, rung) => Next::Continue { trial, rung },
            Some(_) => Next::Wait,
            None => Next::Done,
        }
    }

    /// The best trials of a rung that have not reached the next one, best first.
    fn climbing(&self, reached: &Reached, rung: usize) -> Vec<usize> {
        let mut at_rung: Vec<(usize, f64)> =
            reached.iter().filter_map(|(trial, rungs)| Some((*trial, (*rungs.get(&rung)?)?))).collect();
        // Failed trials are included, so that a rung full of failures does not block the others.
        let count = reached.values().filter(|rungs| rungs.contains_key(&rung)).count();
        at_rung.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let best = at_rung.into_iter().take(count / self.reduction.max(1));
        best.map(|(trial, _)| trial).filter(|trial| !reached[trial].contains_key(&(rung + 1))).collect()
    }

    /// The best trial of the highest rung, if no trial is completed: even if there are too few trials for the rule, the
    /// best one continues.
    fn last_resort(&self, reached: &Reached) -> Option<(usize, usize)> {
        let at = |rung: usize| reached.iter().filter_map(move |(trial, rungs)| Some((*trial, (*rungs.get(&rung)?)?)));
        let highest = (0..self.rungs).rev().find(|&rung| at(rung).next().is_some())?;
        let is_failed = |rung: usize| reached.values().any(|rungs| rungs.get(&rung) == Some(&None));
        if highest + 1 >= self.rungs || is_failed(highest + 1) {
            return None;
        }
        let (trial, _) = at(highest).max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))?;
        Some((trial, highest + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes next if no other process works on the search.
    fn alone(halving: &Halving, reached: &Reached, most: usize) -> Next {
        halving.next(&Trials { reached, started: reached.len(), most }, |_, _| true)
    }

    /// Runs a search in which trial `n` reaches the objective `n` at every rung.
    fn search(halving: &Halving, trials: usize) -> Reached {
        let mut reached = Reached::new();
        loop {
            match alone(halving, &reached, trials) {
                Next::Start => {
                    let trial = reached.len();
                    reached.insert(trial, BTreeMap::from([(0, Some((trial * 7 % trials) as f64))]));
                }
                Next::Continue { trial, rung } => {
                    let value = reached[&trial][&0];
                    assert!(reached.get_mut(&trial).unwrap().insert(rung, value).is_none(), "repeated");
                }
                Next::Wait => panic!("no other process works"),
                Next::Done => return reached,
            }
        }
    }

    #[test]
    fn work_of_others_is_left_to_them() {
        let halving = Halving { reduction: 2, rungs: 2 };
        let reached: Reached = [(0, 1.0), (1, 3.0), (2, 2.0), (3, 0.0)]
            .map(|(trial, value)| (trial, BTreeMap::from([(0, Some(value))])))
            .into();
        let next = |held: &[(usize, usize)], started, most| {
            halving.next(&Trials { reached: &reached, started, most }, |trial, rung| !held.contains(&(trial, rung)))
        };
        assert_eq!(next(&[], 4, 4), Next::Continue { trial: 1, rung: 1 });
        assert_eq!(next(&[(1, 1)], 4, 4), Next::Continue { trial: 2, rung: 1 });
        assert_eq!(next(&[(1, 1), (2, 1)], 4, 5), Next::Start);
        assert_eq!(next(&[(1, 1), (2, 1)], 4, 4), Next::Wait);
        // A trial whose process died before it reached anything.
        assert_eq!(next(&[(1, 1), (2, 1)], 5, 5), Next::Continue { trial: 4, rung: 0 });
        assert_eq!(next(&[(1, 1), (2, 1), (4, 0)], 5, 5), Next::Wait);
    }

    #[test]
    fn shares_grow_by_the_reduction() {
        let halving = Halving { reduction: 3, rungs: 3 };
        let shares: Vec<f64> = (0..3).map(|rung| (halving.share(rung) * 9.0).round()).collect();
        assert_eq!(shares, [1.0, 3.0, 9.0]);
        assert_eq!(Halving { reduction: 3, rungs: 1 }.share(0), 1.0);
        // A ninth for all, two ninths for a third, two thirds for a ninth of the trials.
        assert!((halving.mean_share() - 7.0 / 27.0).abs() < 1e-12);
        assert_eq!(Halving { reduction: 3, rungs: 1 }.mean_share(), 1.0);
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
        assert_eq!(alone(&halving, &failed, 4), Next::Done);
        assert_eq!(alone(&halving, &failed, 5), Next::Start);
    }
}
