//! As-rigid-as-possible motion (Sorkine and Alexa 2007): neighbourhoods may move and turn, but should not stretch.

use shaders::arrays::rows::{RowIndex, gather};
use shaders::arrays::totals::total;
use shaders::geometry::neighbor_blend::Neighbors;
use shaders::geometry::quaternion;
use shaders::pointwise::{square, sub};
use shaders::tape::{Real, Tape, Tensor, Var};

/// Pairs of nodes that stay rigid to each other.
pub(crate) struct Rigidity {
    neighbors: Neighbors,
    owner_of_edge: RowIndex,
}

impl Rigidity {
    /// Edges from each node to its nearest nodes at the current positions [M, D]; `None` for a single node.
    pub(crate) fn new<T: Real>(positions: &Tensor<T>, per_node: usize) -> Option<Self> {
        let neighbors = Neighbors::nearest_others(positions, per_node);
        let per_node = neighbors.per_point();
        if per_node == 0 {
            return None;
        }
        let owners = (0..positions.rows() * per_node).map(|edge| (edge / per_node) as u32).collect();
        Some(Self { neighbors, owner_of_edge: RowIndex::new(owners, positions.rows()) })
    }

    /// Σ ‖(p'ⱼ − p'ᵢ) − Rᵢ(pⱼ − pᵢ)‖² over all edges from i to j, shape [1], between positions p and p' [M, 3] of two
    /// moments.
    ///
    /// Rᵢ is the rotation that fits the edges of i best. It is held constant, because the derivative by the optimal
    /// rotation vanishes.
    pub(crate) fn energy<T: Real>(&self, tape: &mut Tape<T>, before: Var, after: Var) -> Var {
        let [edges_before, edges_after] = [before, after].map(|positions| self.edges(tape, positions));
        let rotations = quaternion::best_rotations(tape, edges_before, edges_after, self.neighbors.per_point());
        let turned = quaternion::rotate(tape, rotations, edges_before);
        let stretch = sub(tape, edges_after, turned);
        let squares = square(tape, stretch);
        total(tape, squares)
    }

    /// pⱼ − pᵢ of every edge.
    fn edges<T: Real>(&self, tape: &mut Tape<T>, positions: Var) -> Var {
        let ends = gather(tape, positions, self.neighbors.node_of_item());
        let starts = gather(tape, positions, &self.owner_of_edge);
        sub(tape, ends, starts)
    }
}

/// The published weight of the energy relative to the initial one: 1 until iteration 5000, log-linear decay to 0.1 at
/// 10 000, 0 after 20 000.
pub(crate) fn published_decay(iteration: f64) -> f64 {
    let share = ((iteration - 5000.0) / 5000.0).clamp(0.0, 1.0);
    if iteration > 20_000.0 { 0.0 } else { 0.1_f64.powf(share) }
}
