//! Neighbour search among particles.

use std::collections::BTreeSet;

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scene::point_tree::PointTree;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{RowIndex, gather};
use shaders::tape::{Real, Tape, Var};

use crate::bases::space_filling_curves::{Curve, neighbor_pairs, without_jumps};

/// Neighbours on either side along a curve: as many pairs as with eight nearest neighbours.
const REACH: usize = 4;
/// Number of nearest neighbours of a particle.
const NEAREST: usize = 8;
/// Pairs farther apart than this many times the median are rejected, because the curve jumps there.
const JUMP: f64 = 3.0;

/// Neighbour search of a recipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Neighbors {
    /// Along a Hilbert or a Z-order curve, drawn at random per step.
    Curve,
    /// The eight nearest neighbours.
    Knn,
}

impl Neighbors {
    /// Draws the search of one step.
    pub(crate) fn draw(self, random: &mut ChaCha8Rng) -> Search {
        match self {
            Self::Curve if random.random::<bool>() => Search::Hilbert,
            Self::Curve => Search::ZOrder,
            Self::Knn => Search::Nearest,
        }
    }
}

/// Neighbour search of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Search {
    /// Along a Hilbert curve.
    Hilbert,
    /// Along a Z-order curve.
    ZOrder,
    /// The eight nearest neighbours.
    Nearest,
}

impl Search {
    /// Number of search methods.
    pub(crate) const COUNT: usize = 3;

    /// Pairs of neighbours among positions; curves use cells of side `cell_size`.
    pub(crate) fn pairs(self, positions: &[[f32; 3]], cell_size: f64) -> Vec<[u32; 2]> {
        let along = |curve: Curve| neighbor_pairs(positions, &curve.order(positions, cell_size), REACH, JUMP);
        match self {
            Self::Hilbert => along(Curve::Hilbert),
            Self::ZOrder => along(Curve::ZOrder),
            Self::Nearest => without_jumps(positions, nearest_pairs(positions), JUMP),
        }
    }
}

/// Every pair in which one is among the nearest neighbours of the other, once.
fn nearest_pairs(positions: &[[f32; 3]]) -> Vec<[u32; 2]> {
    let points: Vec<[f64; 3]> = positions.iter().map(|position| position.map(f64::from)).collect();
    let tree = PointTree::new(&points);
    let of_point = |(index, point): (usize, &[f64; 3])| -> Vec<[u32; 2]> {
        let found = tree.nearests(point, NEAREST + 1);
        let others = found.iter().map(|neighbor| neighbor.index).filter(|&other| other != index);
        others.map(|other| [other.min(index) as u32, other.max(index) as u32]).collect()
    };
    let pairs: Vec<Vec<[u32; 2]>> = points.par_iter().enumerate().map(of_point).collect();
    pairs.into_iter().flatten().collect::<BTreeSet<_>>().into_iter().collect()
}

/// A non-empty list of particle pairs.
pub(crate) struct Pairs {
    /// Rows of the first and of the second particle of every pair.
    sides: [RowIndex; 2],
}

impl Pairs {
    /// Pairs among `particles` particles; `None` if the list is empty.
    pub(crate) fn new(pairs: &[[u32; 2]], particles: usize) -> Option<Self> {
        let side = |side: usize| RowIndex::new(pairs.iter().map(|pair| pair[side]).collect(), particles);
        (!pairs.is_empty()).then(|| Self { sides: [0, 1].map(side) })
    }

    /// Gathers the rows of x [P, …] of the first and the second particle of every pair.
    pub(crate) fn both<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> [Var; 2] {
        self.sides.each_ref().map(|side| gather(tape, x, side))
    }
}
