//! Neighbours move alike and at the same time (KineticGS equation 12).

use std::collections::BTreeSet;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shaders::losses::mean;
use shaders::pointwise::{mul, scale, square, sub};
use shaders::rows::{RowIndex, gather};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::particles::{Moved, Particles};
use crate::bases::space_filling_curves::{Curve, neighbor_pairs, without_jumps};

/// Neighbours on either side along a curve: as many pairs as eight nearest neighbours make.
const REACH: usize = 4;
/// Nearest neighbours of a particle.
const NEAREST: usize = 8;
/// Pairs farther apart than this many times the median are not neighbours: the curve jumped.
const JUMP: f64 = 3.0;
/// The least length by which displacements are measured, as a share of the scene's extent.
const LEAST_UNIT: f64 = 1e-3;

/// How neighbours are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Neighbors {
    /// Along a Hilbert or a Z-order curve, whichever the step draws.
    Curve,
    /// The eight nearest.
    Knn,
}

impl Neighbors {
    /// Pairs of neighbours among positions.
    pub fn pairs(self, positions: &[[f32; 3]], cell_size: f64, random: &mut ChaCha8Rng) -> Vec<[u32; 2]> {
        match self {
            Self::Curve => {
                let curve = if random.random::<bool>() { Curve::Hilbert } else { Curve::ZOrder };
                neighbor_pairs(positions, &curve.order(positions, cell_size), REACH, JUMP)
            }
            Self::Knn => without_jumps(positions, nearest_pairs(positions), JUMP),
        }
    }
}

/// Every pair of which one is among the nearest of the other, once.
fn nearest_pairs(positions: &[[f32; 3]]) -> Vec<[u32; 2]> {
    let points: Vec<[f64; 3]> = positions.iter().map(|position| position.map(f64::from)).collect();
    let tree: ImmutableKdTree<f64, 3> = match ImmutableKdTree::new_from_slice(&points) {
        Ok(tree) => tree,
        // No points have no neighbours.
        Err(_) => return Vec::new(),
    };
    let wanted = NonZero::new(NEAREST + 1).expect("not zero");
    let of_point = |(index, point): (usize, &[f64; 3])| -> Vec<[u32; 2]> {
        let found = tree.query(point).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
        let others = found.iter().map(|neighbor| neighbor.item).filter(|&other| other != index as u32);
        others.map(|other| [other.min(index as u32), other.max(index as u32)]).collect()
    };
    let pairs: Vec<Vec<[u32; 2]>> = points.par_iter().enumerate().map(of_point).collect();
    pairs.into_iter().flatten().collect::<BTreeSet<_>>().into_iter().collect()
}

/// Mean squared difference of the displacements of neighbours that are active, in units of the root mean square
/// displacement; `None` where no two neighbours are.
pub fn displacement_incoherence<T: Real>(
    tape: &mut Tape<T>,
    moved: &Moved,
    particle_count: usize,
    pairs: &[[u32; 2]],
    extent: f64,
) -> Option<Var> {
    let displacements = moved.displacements?;
    let mut place = vec![None; particle_count];
    moved.active.iter().enumerate().for_each(|(at, &particle)| place[particle as usize] = Some(at as u32));
    let both = |[first, second]: &[u32; 2]| Some([place[*first as usize]?, place[*second as usize]?]);
    let pairs: Vec<[u32; 2]> = pairs.iter().filter_map(both).collect();
    let difference = mean_squared_difference(tape, displacements, &pairs)?;
    let values = tape.value(displacements);
    let sum: f64 = values.as_slice().iter().map(|value| value.to_f64().powi(2)).sum();
    let squared_unit = (sum / values.rows() as f64).max((LEAST_UNIT * extent).powi(2));
    let per_squared_unit = tape.detach_value(Tensor::scalar(T::from_f64(1.0 / squared_unit)));
    Some(mul(tape, difference, per_squared_unit))
}

/// Mean squared difference of the window centres of neighbours, in shares of all time; `None` without windows or pairs.
pub fn window_incoherence<T: Real>(tape: &mut Tape<T>, particles: &Particles, pairs: &[[u32; 2]]) -> Option<Var> {
    mean_squared_difference(tape, particles.windows?.centers, pairs)
}

/// Mean over pairs (i, j) of ‖xᵢ − xⱼ‖² for x [N, C], shape [1]; `None` without pairs.
fn mean_squared_difference<T: Real>(tape: &mut Tape<T>, x: Var, pairs: &[[u32; 2]]) -> Option<Var> {
    if pairs.is_empty() {
        return None;
    }
    let (rows, columns) = (tape.value(x).rows(), tape.value(x).row_len());
    let [first, second] = [0, 1].map(|side| {
        let index = RowIndex::new(pairs.iter().map(|pair| pair[side]).collect(), rows);
        gather(tape, x, &index)
    });
    let difference = sub(tape, first, second);
    let squared = square(tape, difference);
    let mean = mean(tape, squared);
    Some(scale(tape, mean, columns as f64))
}
