//! Samplers: choose the values that the next trials of a search try.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::space::Space;

/// Minimum number of compared trials before points are drawn near the best.
const WARM_UP: usize = 10;
/// The share of compared trials that count as good.
const GOOD_SHARE: f64 = 0.25;
/// Number of candidates; the one with the largest ratio of densities is tried.
const CANDIDATES: usize = 24;
/// The least and the greatest bandwidth, as shares of a parameter's range. A triangular kernel reaches twice as far.
const BANDWIDTH: [f64; 2] = [0.05, 0.3];

/// How points are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Each combination of values once.
    Grid,
    /// Independent and uniform.
    Random,
    /// A scrambled Sobol sequence, which covers the space evenly.
    Sobol,
    /// Half of the points random, half near the best trials so far.
    Tpe,
}

/// Chooses the points of a search. The point of a trial depends on its number, the seed and, for [`Strategy::Tpe`], on what
/// other trials reached.
#[derive(Clone, Debug)]
pub struct Sampler {
    /// How points are chosen.
    pub strategy: Strategy,
    /// The space.
    pub space: Space,
    /// The seed of all random choices.
    pub seed: u64,
}

impl Sampler {
    /// The name of the sequence of points: samplers of one space with equal names draw equal points, unless
    /// [`Strategy::Tpe`] has seen other trials. A grid does not depend on the seed.
    pub fn sequence(&self) -> String {
        match self.strategy {
            Strategy::Grid => "grid".into(),
            Strategy::Random => format!("random {}", self.seed),
            Strategy::Sobol => format!("sobol {}", self.seed),
            Strategy::Tpe => format!("tpe {}", self.seed),
        }
    }

    /// The point of trial `number`, one coordinate in [0, 1) per parameter; `None` if the grid has no more points.
    /// `compared` has the points and objectives (larger is better) of trials that were compared with each other.
    pub fn point(&self, number: usize, compared: &[(Vec<f64>, f64)]) -> Option<Vec<f64>> {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed ^ (number as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let dimensions = self.space.0.len();
        match self.strategy {
            Strategy::Grid => (number < self.space.grid_size()?).then(|| self.space.grid_point(number)),
            Strategy::Random => Some(uniform(dimensions, &mut random)),
            Strategy::Sobol => {
                let seed = self.seed as u32;
                let at = |dimension: usize| f64::from(sobol_burley::sample(number as u32, dimension as u32, seed));
                Some((0..dimensions).map(at).collect())
            }
            Strategy::Tpe if compared.len() < WARM_UP || number.is_multiple_of(2) => {
                Some(uniform(dimensions, &mut random))
            }
            Strategy::Tpe => Some(near_the_best(dimensions, compared, &mut random)),
        }
    }
}

fn uniform(dimensions: usize, random: &mut impl Rng) -> Vec<f64> {
    (0..dimensions).map(|_| random.random_range(0.0..1.0)).collect()
}

/// Draws candidates from the density of good points, and returns the one with the largest ratio to the density of the
/// others.
fn near_the_best(dimensions: usize, compared: &[(Vec<f64>, f64)], random: &mut impl Rng) -> Vec<f64> {
    let mut sorted: Vec<&(Vec<f64>, f64)> = compared.iter().collect();
    sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
    let count = ((sorted.len() as f64 * GOOD_SHARE).ceil() as usize).clamp(1, sorted.len());
    let (good, others) = sorted.split_at(count);
    let candidates = (0..CANDIDATES).map(|_| {
        let around = &good[random.random_range(0..good.len())].0;
        (0..dimensions).map(|at| drawn_near(around[at], bandwidth(good.len()), random)).collect::<Vec<f64>>()
    });
    let score = |point: &Vec<f64>| log_density(point, good) - log_density(point, others);
    let scored = candidates.map(|point| (score(&point), point));
    scored.max_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(|| uniform(dimensions, random), |(_, point)| point)
}

fn bandwidth(points: usize) -> f64 {
    (0.5 / (points as f64).sqrt()).clamp(BANDWIDTH[0], BANDWIDTH[1])
}

/// A triangular deviate around `center`, reflected into [0, 1).
fn drawn_near(center: f64, width: f64, random: &mut impl Rng) -> f64 {
    let step: f64 = random.random_range(-1.0..1.0) + random.random_range(-1.0..1.0);
    let at = (center + step * width).abs();
    let at = if at >= 1.0 { 2.0 - at } else { at };
    at.clamp(0.0, 1.0 - f64::EPSILON)
}

/// The logarithm of a product of kernel densities, one per parameter, with a uniform part that keeps it positive.
fn log_density(point: &[f64], of: &[&(Vec<f64>, f64)]) -> f64 {
    let width = 2.0 * bandwidth(of.len().max(1));
    let kernel = |distance: f64| (1.0 - distance / width).max(0.0) / width;
    let along = |at: usize| {
        let sum: f64 = of.iter().map(|(other, _)| kernel((point[at] - other[at]).abs())).sum();
        ((sum + 1.0) / (of.len() as f64 + 1.0)).ln()
    };
    (0..point.len()).map(along).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampler(strategy: Strategy) -> Sampler {
        let space = Space(vec!["a=uniform(0, 1)".parse().unwrap(), "b=uniform(0, 1)".parse().unwrap()]);
        Sampler { strategy, space, seed: 7 }
    }

    /// The best of a smooth function after `trials` points, and all points.
    fn search(strategy: Strategy, trials: usize) -> f64 {
        let sampler = sampler(strategy);
        let mut seen: Vec<(Vec<f64>, f64)> = Vec::new();
        for number in 0..trials {
            let point = sampler.point(number, &seen).unwrap();
            assert!(point.iter().all(|at| (0.0..1.0).contains(at)), "{point:?}");
            let value = -(point[0] - 0.3).powi(2) - (point[1] - 0.8).powi(2);
            seen.push((point, value));
        }
        seen.into_iter().map(|(_, value)| value).fold(f64::NEG_INFINITY, f64::max)
    }

    #[test]
    fn points_near_the_best_find_an_optimum_that_random_ones_miss() {
        let (tpe, random) = (search(Strategy::Tpe, 80), search(Strategy::Random, 80));
        assert!(tpe > -3e-4, "{tpe}");
        assert!(tpe > random, "{tpe} against {random}");
    }

    #[test]
    fn sobol_points_are_spread_evenly() {
        let sampler = sampler(Strategy::Sobol);
        let cells: std::collections::BTreeSet<(usize, usize)> = (0..16)
            .map(|number| sampler.point(number, &[]).unwrap())
            .map(|point| ((point[0] * 4.0) as usize, (point[1] * 4.0) as usize))
            .collect();
        assert_eq!(cells.len(), 16, "one point per cell of a 4 × 4 grid");
    }

    #[test]
    fn a_trial_of_the_same_number_has_the_same_point() {
        let sampler = sampler(Strategy::Random);
        assert_eq!(sampler.point(3, &[]), sampler.point(3, &[(vec![0.0, 0.0], 1.0)]));
        assert_ne!(sampler.point(3, &[]), sampler.point(4, &[]));
        let other = Sampler { seed: 8, ..sampler.clone() };
        assert_ne!(sampler.point(3, &[]), other.point(3, &[]));
        assert_ne!(sampler.sequence(), other.sequence());
        let grid = |seed| Sampler { strategy: Strategy::Grid, seed, ..sampler.clone() }.sequence();
        assert_eq!(grid(7), grid(8));
        assert_ne!(grid(7), sampler.sequence());
    }
}
