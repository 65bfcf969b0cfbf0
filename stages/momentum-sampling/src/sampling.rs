//! Weighted sampling of pixels by momentum energy (equation 4), at most one per voxel.

use std::collections::HashSet;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Energies `E = |p|² / Σ|p|²` over all candidates; all 0 if nothing moves.
pub(crate) fn energies(squared_norms: &[f64]) -> Vec<f64> {
    let sum: f64 = squared_norms.iter().sum();
    squared_norms.iter().map(|norm| if sum > 0.0 { norm / sum } else { 0.0 }).collect()
}

/// A random order of the candidates: draws without replacement, each with a probability proportional to
/// `weight · E + (1 - weight) / N`; uniform if all energies are 0.
///
/// Sorting by the keys `ln(u) / w` in descending order gives such draws, for any number of them (Efraimidis and
/// Spirakis 2006).
pub(crate) fn draw_order(energies: &[f64], energy_weight: f64, seed: u64) -> Vec<usize> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let energy_weight = if energies.iter().any(|energy| *energy > 0.0) { energy_weight } else { 0.0 };
    let uniform = (1.0 - energy_weight) / energies.len().max(1) as f64;
    let key = |energy: &f64| {
        // The number is in (0, 1], so that its logarithm is finite.
        let uniform_random = 1.0 - random.random::<f64>();
        uniform_random.ln() / (energy_weight * energy + uniform)
    };
    let keys: Vec<f64> = energies.iter().map(key).collect();
    let mut order: Vec<usize> = (0..energies.len()).collect();
    // A candidate with weight 0 has the key -∞, or NaN if its random number is 1, and comes last. Ties keep their
    // order.
    let finite = |at: usize| if keys[at].is_nan() { f64::NEG_INFINITY } else { keys[at] };
    order.sort_by(|&a, &b| finite(b).total_cmp(&finite(a)));
    order
}

/// The first `count` candidates in drawing order that share no voxel with an earlier one; a voxel size of 0 keeps every
/// candidate.
pub(crate) fn one_per_voxel(
    order: &[usize],
    position: impl Fn(usize) -> DVec3,
    voxel_size: f64,
    count: usize,
) -> Vec<usize> {
    let mut taken = HashSet::new();
    let free =
        |at: &usize| voxel_size == 0.0 || taken.insert((position(*at) / voxel_size).floor().as_i64vec3().to_array());
    order.iter().copied().filter(free).take(count).collect()
}
