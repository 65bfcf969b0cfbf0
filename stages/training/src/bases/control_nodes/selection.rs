//! Selection of points as nodes.

use rayon::prelude::*;
use shaders::tape::{Real, Tensor};

/// Points per parallel chunk.
const POINTS_PER_CHUNK: usize = 4096;

/// Up to `count` rows of `points` [N, D] that lie far apart: the first point, then repeatedly the point farthest from
/// those chosen (Gonzalez 1985); the first one among equals. No two of them are equal.
pub(crate) fn farthest_points<T: Real>(points: &Tensor<T>, count: usize) -> Vec<usize> {
    let mut chosen = Vec::with_capacity(count.min(points.rows()));
    let mut distances = vec![T::from_f64(f64::INFINITY); points.rows()];
    let (mut next, mut distance) = (0, T::ONE);
    while chosen.len() < count.min(points.rows()) && distance > T::ZERO {
        chosen.push(next);
        let from = points.row(next);
        let farthest_of = |(chunk, distances): (usize, &mut [T])| {
            let first = chunk * POINTS_PER_CHUNK;
            lower_distances(points, first, from, distances);
            first_largest(first, distances)
        };
        let farthest: Vec<(usize, T)> =
            distances.par_chunks_mut(POINTS_PER_CHUNK).enumerate().map(farthest_of).collect();
        let larger = |best: (usize, T), other: (usize, T)| if other.1 > best.1 { other } else { best };
        (next, distance) = farthest.into_iter().reduce(larger).expect("at least one point");
    }
    chosen
}

/// Lowers every distance to the distance from `from`, if that is smaller.
fn lower_distances<T: Real>(points: &Tensor<T>, first: usize, from: &[T], distances: &mut [T]) {
    for (at, distance) in distances.iter_mut().enumerate() {
        let squared = points.row(first + at).iter().zip(from).map(|(&a, &b)| (a - b) * (a - b)).sum();
        *distance = distance.min(squared);
    }
}

fn first_largest<T: Real>(first: usize, distances: &[T]) -> (usize, T) {
    let mut best = 0;
    for (at, distance) in distances.iter().enumerate() {
        if *distance > distances[best] {
            best = at;
        }
    }
    (first + best, distances[best])
}

/// The sides of the smallest box around points [N, 3].
pub(crate) fn sides<T: Real>(points: &Tensor<T>) -> [f64; 3] {
    [0, 1, 2].map(|axis| {
        let values = || (0..points.rows()).map(|row| points.row(row)[axis].to_f64());
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    })
}
