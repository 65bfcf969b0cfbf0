//! Neighbours move alike: the optional regulariser of the published code.

use anyhow::Context as _;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use shaders::losses::mean;
use shaders::pointwise::{mul, scale, sub};
use shaders::rows::{RowIndex, gather, norm};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::settings::Settings;

/// The time over which displacements are compared, as a share of the clip (0.1 s of a clip of one second).
const DURATION: f64 = 0.1;
/// 1 / (distance at which a neighbour counts e⁻¹)², in scene units (published code).
const FALLOFF: f64 = 100.0;

/// Pairs of neighbouring rows and how much each counts.
struct Pairs {
    first: Vec<u32>,
    second: Vec<u32>,
    weights: Vec<f64>,
}

/// mean over pairs of e^(−100·d²)·‖vᵢ − vⱼ‖ with displacements v over a tenth of the clip and distances d, both at one
/// time: positions and velocities [M, 3]. `None` where there are no two Gaussians.
pub fn loss<T: Real>(
    tape: &mut Tape<T>,
    positions: Var,
    velocities: Var,
    settings: &Settings,
    random: &mut ChaCha8Rng,
) -> Option<Var> {
    // Who is whose neighbour, and how much that counts, is not differentiated.
    let fixed = tape.detach(positions);
    let points: Vec<[f64; 3]> =
        tape.value(fixed).as_slice().as_chunks::<3>().0.iter().map(|point| point.map(|value| value.to_f64())).collect();
    let Pairs { first, second, weights } =
        neighbors(&points, settings, random).filter(|pairs| !pairs.first.is_empty())?;
    let displacements = scale(tape, velocities, DURATION);
    let mut of = |rows: Vec<u32>| gather(tape, displacements, &RowIndex::new(rows, points.len()));
    let (first, second) = (of(first), of(second));
    let difference = sub(tape, first, second);
    let lengths = norm(tape, difference);
    let weights = Tensor::from_vec([weights.len(), 1], weights.into_iter().map(T::from_f64).collect());
    let weights = tape.constant(weights);
    let weighted = mul(tape, lengths, weights);
    Some(mean(tape, weighted))
}

/// The neighbours of some points, drawn at random. `None` where points cannot be indexed.
fn neighbors(points: &[[f64; 3]], settings: &Settings, random: &mut ChaCha8Rng) -> Option<Pairs> {
    let tree: ImmutableKdTree<f64, 3> =
        ImmutableKdTree::new_from_slice(points).context("cannot index the Gaussians").ok()?;
    let mut chosen = sample(random, points.len(), settings.rigid_samples.min(points.len())).into_vec();
    chosen.sort_unstable();
    let mut pairs = Pairs { first: Vec::new(), second: Vec::new(), weights: Vec::new() };
    let wanted = std::num::NonZero::new(settings.rigid_neighbors + 1).expect("positive");
    for at in chosen {
        let found = tree.query(&points[at]).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
        for neighbor in found.iter().filter(|neighbor| neighbor.item as usize != at) {
            pairs.first.push(at as u32);
            pairs.second.push(neighbor.item);
            pairs.weights.push((-FALLOFF * neighbor.distance).exp());
        }
    }
    Some(pairs)
}
