//! The optional rigidity loss of the published code (`lambda_rigid` in its `train.py`): neighbours move alike.

use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use shaders::arrays::rows::{RowIndex, gather, norm};
use shaders::arrays::totals::total;
use shaders::geometry::neighbor_blend::Neighbors;
use shaders::pointwise::{exponential, mul, scale, sub};
use shaders::tape::{Real, Tape, Var};

use super::settings::Settings;

/// Time over which displacements are compared, in the published code's unit of time, which equals `unit_world` of the
/// units in which times are stored.
const DURATION: f64 = 0.1;
/// Decay rate of a neighbour's weight e^(−100·d) with the distance d, which is in units of `unit_world` (published
/// code).
const FALLOFF: f64 = 100.0;

/// Σ e^(−100·d)·‖vᵢ − vⱼ‖ / (k·number of i) over random Gaussians i and the k Gaussians j nearest to each, shape [1]. The
/// nearest one is i itself. d is the distance between the means, each at its own time, v the displacement over a tenth of
/// a unit of time, both in `unit_world` scene units.
///
/// `positions` [N, 3] are those means in scene units, and get no gradient; `velocities` [N, 3] are in scene units per unit
/// of time. With fewer than k Gaussians, the missing ones count as 0. `None` with fewer than two Gaussians.
pub(crate) fn loss<T: Real>(
    tape: &mut Tape<T>,
    positions: Var,
    velocities: Var,
    settings: &Settings,
    unit_world: f64,
    random: &mut ChaCha8Rng,
) -> Option<Var> {
    let count = tape.value(positions).rows();
    if count < 2 {
        return None;
    }
    let chosen = choose(count, settings.rigid_samples, random);
    // The neighbour search and the weights are not differentiated.
    let positions = tape.detach(positions);
    let of_chosen = gather(tape, positions, &chosen);
    let neighbors = Neighbors::nearest(tape.value(of_chosen), tape.value(positions), settings.rigid_neighbors);
    let per_chosen = neighbors.per_point();
    let owners = (0..chosen.len() * per_chosen).map(|pair| chosen.row_of_item()[pair / per_chosen]).collect();
    let owners = RowIndex::new(owners, count);

    let mut apart = |of: Var| {
        let (first, second) = (gather(tape, of, &owners), gather(tape, of, neighbors.node_of_item()));
        let difference = sub(tape, first, second);
        norm(tape, difference)
    };
    let (distances, changes) = (apart(positions), apart(velocities));
    let exponents = scale(tape, distances, -FALLOFF / unit_world);
    let weights = exponential(tape, exponents);
    let weighted = mul(tape, changes, weights);
    let sum = total(tape, weighted);
    Some(scale(tape, sum, DURATION / (chosen.len() * settings.rigid_neighbors) as f64))
}

/// At most `samples` random rows of `count`, ascending.
fn choose(count: usize, samples: usize, random: &mut ChaCha8Rng) -> RowIndex {
    let mut chosen = sample(random, count, samples.min(count)).into_vec();
    chosen.sort_unstable();
    RowIndex::new(chosen.into_iter().map(|row| row as u32).collect(), count)
}
