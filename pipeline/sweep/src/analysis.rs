//! Analysis of a search: the best value versus cost, the trade-off with time, and the importance of parameters.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::history::Entry;
use crate::space::Space;

/// Groups into which the values of a range are divided.
const GROUPS: usize = 4;
/// Parameters with up to this many values have a group for each of them.
const FEW_VALUES: usize = 2 * GROUPS;
/// Resamples for an interval.
const RESAMPLES: usize = 400;

/// The best objective of completed trials after a number of seconds of training of the whole search: (seconds, objective), one
/// pair per improvement. `last` is the rung that completes a trial.
pub fn best_over_cost(entries: &[Entry], last: usize) -> Vec<(f64, f64)> {
    let mut spent_by_trial = std::collections::BTreeMap::new();
    let (mut spent, mut best, mut curve) = (0.0, f64::NEG_INFINITY, Vec::new());
    for entry in entries {
        // The seconds of an entry count from the beginning of its trial.
        let before = spent_by_trial.insert(entry.trial, entry.secs).unwrap_or(0.0);
        spent += (entry.secs - before).max(0.0);
        if let Some(objective) = entry.objective.filter(|objective| entry.rung == last && *objective > best) {
            best = objective;
            curve.push((spent, objective));
        }
    }
    curve
}

/// The Pareto front of the completed trials by objective and seconds, fastest first.
pub fn pareto(entries: &[Entry], last: usize) -> Vec<&Entry> {
    let mut completed: Vec<&Entry> =
        entries.iter().filter(|entry| entry.rung == last && entry.objective.is_some()).collect();
    completed.sort_by(|a, b| {
        a.secs.total_cmp(&b.secs).then(b.objective.unwrap_or(0.0).total_cmp(&a.objective.unwrap_or(0.0)))
    });
    let mut best = f64::NEG_INFINITY;
    completed.retain(|entry| {
        let objective = entry.objective.unwrap_or(f64::NEG_INFINITY);
        let is_better = objective > best;
        best = best.max(objective);
        is_better
    });
    completed
}

/// The share of the objective's variance that a parameter explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Importance {
    /// The share of the variance between groups of equal or similar values, adjusted for the number of groups.
    pub share: f64,
    /// The 5th and the 95th percentile of the share over resampled trials.
    pub interval: [f64; 2],
}

/// The importance of each parameter of `space` for trials that were compared with each other, by their points and
/// objectives; `None` if too few trials set the parameter.
pub fn importance(space: &Space, compared: &[(Vec<f64>, f64)]) -> Vec<Option<Importance>> {
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let of_parameter = |at: usize| {
        let index = |coordinate: f64| space.0[at].index_at(coordinate, FEW_VALUES);
        let set = compared.iter().filter(|(point, _)| space.active(point)[at]);
        let all: Vec<(f64, f64)> = set.map(|(point, objective)| (point[at], *objective)).collect();
        if all.len() < 2 * GROUPS {
            return None;
        }
        let mut resampled: Vec<f64> = (0..RESAMPLES)
            .map(|_| (0..all.len()).map(|_| all[random.random_range(0..all.len())]).collect::<Vec<_>>())
            .map(|sample| explained(&sample, index))
            .collect();
        resampled.sort_by(f64::total_cmp);
        let interval = [RESAMPLES / 20, RESAMPLES - 1 - RESAMPLES / 20].map(|rank| resampled[rank]);
        Some(Importance { share: explained(&all, index), interval })
    };
    (0..space.0.len()).map(of_parameter).collect()
}

/// The adjusted share of the variance between groups: those of equal values where `index` numbers the values, otherwise
/// those of neighbouring coordinates.
fn explained(pairs: &[(f64, f64)], index: impl Fn(f64) -> Option<usize>) -> f64 {
    let mut sorted = pairs.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = sorted.len() as f64;
    let mean = sorted.iter().map(|(_, value)| value).sum::<f64>() / count;
    let total: f64 = sorted.iter().map(|(_, value)| (value - mean).powi(2)).sum();
    if !(total > 0.0) {
        return 0.0;
    }
    let size = sorted.len().div_ceil(GROUPS);
    let groups: Vec<&[(f64, f64)]> = match index(sorted[0].0) {
        Some(_) => sorted.chunk_by(|a, b| index(a.0) == index(b.0)).collect(),
        None => sorted.chunks(size).collect(),
    };
    let within: f64 = groups
        .iter()
        .map(|group| {
            let mean = group.iter().map(|(_, value)| value).sum::<f64>() / group.len() as f64;
            group.iter().map(|(_, value)| (value - mean).powi(2)).sum::<f64>()
        })
        .sum();
    let groups = groups.len() as f64;
    let adjusted = 1.0 - (within / (count - groups).max(1.0)) / (total / (count - 1.0));
    adjusted.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::tests::entry;

    #[test]
    fn cost_counts_a_continued_trial_once() {
        let entries = [
            entry(0, 0, 0.1, Some(1.0), 10.0),
            entry(1, 0, 0.2, Some(2.0), 10.0),
            entry(1, 1, 0.2, Some(3.0), 30.0),
            entry(0, 1, 0.1, Some(2.0), 25.0),
        ];
        assert_eq!(best_over_cost(&entries, 1), [(40.0, 3.0)]);
        let front: Vec<usize> = pareto(&entries, 1).iter().map(|entry| entry.trial).collect();
        assert_eq!(front, [0, 1], "the faster one first, then the better one");
    }

    #[test]
    fn the_parameter_that_matters_is_found() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut trial = || {
            let point: Vec<f64> = (0..2).map(|_| random.random_range(0.0..1.0)).collect();
            let value = 10.0 * point[0] + random.random_range(-0.5..0.5);
            (point, value)
        };
        let compared: Vec<_> = (0..40).map(|_| trial()).collect();
        let space = |second: &str| Space(vec!["a=uniform(0, 1)".parse().unwrap(), second.parse().unwrap()]);
        let found = importance(&space("b=uniform(0, 1)"), &compared);
        let [first, second] = [0, 1].map(|at| found[at].unwrap());
        assert!(first.share > 0.8 && first.interval[0] > 0.6, "{found:?}");
        assert!(second.share < 0.2 && second.interval[0] < 0.05, "{found:?}");
        assert_eq!(importance(&space("b=uniform(0, 1)"), &compared[..3]), [None, None]);
        // Listed values are not ordered: the middle one of three decides.
        let listed: Vec<_> =
            (0..24).map(|at| (vec![0.5, (at % 3) as f64 / 3.0 + 0.1], f64::from(at % 3 == 1))).collect();
        let share = importance(&space("b=x,y,z"), &listed)[1].unwrap().share;
        assert!(share > 0.99, "{share}");
        assert_eq!(importance(&space("b=uniform(0, 1) when a=7"), &compared)[1], None, "no trial sets it");
    }
}
