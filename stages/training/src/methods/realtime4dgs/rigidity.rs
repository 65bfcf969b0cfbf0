//! The optional rigidity regulariser of the published code: neighbours move alike.

use kd_tree::KdIndexTree;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use shaders::arrays::rows::{RowIndex, concat_columns, divide_rows, gather, norm, reshape, squared_norm};
use shaders::arrays::totals::total;
use shaders::geometry::neighbor_blend::Neighbors;
use shaders::pointwise::{exponential, mul, scale, shift, sub};
use shaders::rasteriser::slicing4d::SlicedVars;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::settings::Settings;

/// The time over which displacements are compared, in the method's unit of time, i.e. in `unit_world` units of time
/// (published code).
const DURATION: f64 = 0.1;
/// 1 / (distance at which a neighbour's weight is e⁻¹)², in [`SceneFacts::unit_world`] (published code).
const FALLOFF: f64 = 100.0;
/// Distance of absent Gaussians from all others, in the same unit, at which their weight vanishes.
const ELSEWHERE: f64 = 1e3;

/// Σ e^(−100·d²)·‖vᵢ − vⱼ‖ over random Gaussians i and the nearest neighbours j of each, divided by the number of
/// pairs, with displacements v over a tenth of a unit of time and distances d at one time, both in `unit_world` scene units;
/// positions [N, 3]. Absent Gaussians do not contribute. `None` with fewer than two Gaussians.
pub(crate) fn loss<T: Real>(
    tape: &mut Tape<T>,
    positions: Var,
    sliced: &SlicedVars,
    settings: &Settings,
    unit_world: f64,
    random: &mut ChaCha8Rng,
) -> Option<Var> {
    let count = tape.value(positions).rows();
    let mut chosen = sample(random, count, settings.rigid_samples.min(count)).into_vec();
    chosen.sort_unstable();
    let chosen = RowIndex::new(chosen.into_iter().map(|row| row as u32).collect(), count);
    // The neighbour search and the weights are not differentiated.
    let positions = in_units(tape, positions, unit_world);
    let places = places(tape, positions, sliced.present);
    let of_chosen = gather(tape, places, &chosen);
    // One neighbour is the Gaussian itself, with a difference of zero.
    let (neighbors, per_chosen) = nearest(tape, of_chosen, places, settings.rigid_neighbors + 1)?;
    let owners = (0..chosen.len() * per_chosen).map(|pair| chosen.row_of_item()[pair / per_chosen]).collect();
    let owners = RowIndex::new(owners, count);

    let displacements = scale(tape, sliced.velocities, DURATION);
    let mut apart = |of: Var| {
        let (first, second) = (gather(tape, of, &owners), gather(tape, of, &neighbors));
        sub(tape, first, second)
    };
    let (distances, changes) = (apart(places), apart(displacements));
    let squared = squared_norm(tape, distances);
    let exponents = scale(tape, squared, -FALLOFF);
    let weights = exponential(tape, exponents);
    let lengths = norm(tape, changes);
    let weighted = mul(tape, lengths, weights);
    let sum = total(tape, weighted);

    let pairs_per_chosen = (per_chosen - 1) as f64;
    let present = gather(tape, sliced.present, &chosen);
    let present = tape.detach(present);
    let present = total(tape, present);
    let pairs = scale(tape, present, pairs_per_chosen);
    let mean = divide_rows(tape, sum, pairs, pairs_per_chosen);
    Some(reshape(tape, mean, [1]))
}

/// Lengths in scene units, in units of `unit_world`.
fn in_units<T: Real>(tape: &mut Tape<T>, lengths: Var, unit_world: f64) -> Var {
    if unit_world == 1.0 { lengths } else { scale(tape, lengths, 1.0 / unit_world) }
}

/// Positions in four dimensions [N, 4]; absent Gaussians are displaced by [`ELSEWHERE`] along the fourth axis.
fn places<T: Real>(tape: &mut Tape<T>, positions: Var, present: Var) -> Var {
    let positions = tape.detach(positions);
    let missing = scale(tape, present, -ELSEWHERE);
    let missing = shift(tape, missing, ELSEWHERE);
    let places = concat_columns(tape, &[positions, missing]);
    tape.detach(places)
}

/// The `count` nearest places of each point, or all if there are fewer, and their number; `None` if it is below two or
/// the places cannot be indexed. Searches a k-d tree on the CPU and all places on a GPU.
fn nearest<T: Real>(tape: &Tape<T>, points: Var, places: Var, count: usize) -> Option<(RowIndex, usize)> {
    let (points, places) = (tape.value(points), tape.value(places));
    let per_point = count.min(places.rows());
    if per_point < 2 || points.rows() == 0 {
        return None;
    }
    if tape.device() != Device::Cpu {
        return Some((Neighbors::nearest(points, places, per_point).node_of_item().clone(), per_point));
    }
    let (points, places) = (coordinates(points), coordinates(places));
    let tree = KdIndexTree::build_by_ordered_float(&places);
    let of_point = |point: &[f64; 4]| tree.nearests(point, per_point).into_iter().map(|place| *place.item as u32);
    let found = points.iter().flat_map(of_point).collect();
    Some((RowIndex::new(found, places.len()), per_point))
}

fn coordinates<T: Real>(rows: &Tensor<T>) -> Vec<[f64; 4]> {
    rows.as_slice().as_chunks::<4>().0.iter().map(|row| row.map(|value| value.to_f64())).collect()
}
