//! Neighbours move alike and at the same time (KineticGS equation 12).

use std::collections::BTreeSet;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{RowIndex, divide_rows, gather, reshape, squared_norm};
use shaders::arrays::totals::{mean, weighted_mean};
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Tape, Var};

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
    /// How they are found in a step.
    pub fn draw(self, random: &mut ChaCha8Rng) -> Search {
        match self {
            Self::Curve if random.random::<bool>() => Search::Hilbert,
            Self::Curve => Search::ZOrder,
            Self::Knn => Search::Nearest,
        }
    }
}

/// How the neighbours of one step are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// Along a Hilbert curve.
    Hilbert,
    /// Along a Z-order curve.
    ZOrder,
    /// The eight nearest.
    Nearest,
}

impl Search {
    /// Ways to search.
    pub const COUNT: usize = 3;

    /// Pairs of neighbours among positions, by cells of this side along a curve.
    pub fn pairs(self, positions: &[[f32; 3]], cell_size: f64) -> Vec<[u32; 2]> {
        let along = |curve: Curve| neighbor_pairs(positions, &curve.order(positions, cell_size), REACH, JUMP);
        match self {
            Self::Hilbert => along(Curve::Hilbert),
            Self::ZOrder => along(Curve::ZOrder),
            Self::Nearest => without_jumps(positions, nearest_pairs(positions), JUMP),
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

/// Pairs of particles, at least one.
pub struct Pairs {
    /// Of every pair the first, and the second.
    sides: [RowIndex; 2],
}

impl Pairs {
    /// Pairs of so many particles; `None` without any.
    pub fn new(pairs: &[[u32; 2]], particles: usize) -> Option<Self> {
        let side = |side: usize| RowIndex::new(pairs.iter().map(|pair| pair[side]).collect(), particles);
        (!pairs.is_empty()).then(|| Self { sides: [0, 1].map(side) })
    }

    /// What either of each pair has of x [P, …].
    fn both<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> [Var; 2] {
        self.sides.each_ref().map(|side| gather(tape, x, side))
    }

    /// Mean of ‖xᵢ − xⱼ‖² over pairs (i, j) for x [P, C], those of which both have a mask [P, 1] of 1; shape [1].
    fn mean_squared_difference<T: Real>(&self, tape: &mut Tape<T>, x: Var, mask: Option<Var>) -> Var {
        let [first, second] = self.both(tape, x);
        let difference = sub(tape, first, second);
        let squared = squared_norm(tape, difference);
        let mask = mask.map(|mask| {
            let [first, second] = self.both(tape, mask);
            mul(tape, first, second)
        });
        mean_where(tape, squared, mask)
    }
}

/// The mean of x [N, 1], of what has a mask [N, 1] of 1; shape [1].
fn mean_where<T: Real>(tape: &mut Tape<T>, x: Var, mask: Option<Var>) -> Var {
    match mask {
        None => mean(tape, x),
        Some(mask) => weighted_mean(tape, x, mask),
    }
}

/// Mean squared difference of the displacements of neighbours that are active, in units of the root mean square
/// displacement; `None` where the host knows that nothing is active.
pub fn displacement_incoherence<T: Real>(tape: &mut Tape<T>, moved: &Moved, pairs: &Pairs, extent: f64) -> Option<Var> {
    let displacements = moved.displacements?;
    let difference = pairs.mean_squared_difference(tape, displacements, moved.active);
    let lengths = tape.detach(displacements);
    let lengths = squared_norm(tape, lengths);
    let squared_unit = mean_where(tape, lengths, moved.active);
    let value = divide_rows(tape, difference, squared_unit, (LEAST_UNIT * extent).powi(2));
    Some(reshape(tape, value, [1]))
}

/// Mean squared difference of the window centres of neighbours, in shares of all time; `None` without windows.
pub fn window_incoherence<T: Real>(tape: &mut Tape<T>, particles: &Particles<T>, pairs: &Pairs) -> Option<Var> {
    Some(pairs.mean_squared_difference(tape, particles.windows?.centers, None))
}
