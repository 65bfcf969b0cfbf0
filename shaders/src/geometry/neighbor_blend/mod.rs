//! Points that follow control nodes: every point follows a weighted blend of its K nearest nodes (Huang et al. 2024,
//! SC-GS, equations 2 to 4).
//!
//! [`Neighbors`] assigns nodes to points and is not differentiated. [`weights`], [`blend`] and [`blend_frames`] are
//! differentiable in the positions of points and nodes and in the nodes' radii, gates and motions. The gradient of a node is
//! summed over its points in ascending order, on a GPU in parts whose order depends on the sizes alone, so that no result
//! depends on the number of threads.

mod blend;
mod frames;
mod gpu;
mod nearest;
#[cfg(test)]
mod tests;
mod weights;

pub use blend::blend;
pub use frames::{Frames, blend_frames};
pub use weights::weights;

use rayon::prelude::*;

use crate::arrays::rows::RowIndex;
use crate::tape::Real;

/// For each of N points the K of M nodes that it follows, nearest first.
#[derive(Clone, Debug)]
pub struct Neighbors {
    per_point: usize,
    points: usize,
    node_of_item: RowIndex,
}

/// Calls `body(row, values of the row)` for every row of `columns` values, in parallel.
fn for_each_row<T: Real>(values: &mut [T], columns: usize, body: impl Fn(usize, &mut [T]) + Sync) {
    values.par_chunks_mut(columns).enumerate().with_min_len(32).for_each(|(row, values)| body(row, values));
}
