//! As-rigid-as-possible motion (Sorkine and Alexa 2007): neighbourhoods may move and turn, but should not stretch.

use shaders::neighbor_blend::Neighbors;
use shaders::pointwise::{scale, square, sub};
use shaders::quaternion;
use shaders::rows::{RowIndex, gather};
use shaders::tape::{Real, Tape, Tensor, Var};

/// Who stays rigid to whom.
pub struct Rigidity {
    neighbors: Neighbors,
    owner_of_edge: RowIndex,
}

impl Rigidity {
    /// Edges from each node to the nodes nearest to it where they lie now [M, D]. `None` for a single node.
    pub fn new<T: Real>(positions: &Tensor<T>, per_node: usize) -> Option<Self> {
        let neighbors = Neighbors::nearest_others(positions, per_node);
        let per_node = neighbors.per_point();
        if per_node == 0 {
            return None;
        }
        let owners = (0..positions.rows() * per_node).map(|edge| (edge / per_node) as u32).collect();
        Some(Self { neighbors, owner_of_edge: RowIndex::new(owners, positions.rows()) })
    }

    /// Σ ‖(p'ⱼ − p'ᵢ) − Rᵢ(pⱼ − pᵢ)‖² over all edges from i to j, shape [1], between positions p and p' [M, 3] of two moments.
    ///
    /// Rᵢ is the rotation that fits the edges of i best. It is held fixed: where it is best, its derivative vanishes.
    pub fn energy<T: Real>(&self, tape: &mut Tape<T>, before: Var, after: Var) -> Var {
        let [edges_before, edges_after] = [before, after].map(|positions| self.edges(tape, positions));
        let rotations = self.best_rotations(tape.value(edges_before), tape.value(edges_after));
        let rotations = tape.detach_value(rotations);
        let turned = quaternion::rotate(tape, rotations, edges_before);
        let stretch = sub(tape, edges_after, turned);
        let squares = square(tape, stretch);
        let mean = shaders::losses::mean(tape, squares);
        let count = tape.value(squares).len();
        scale(tape, mean, count as f64)
    }

    /// pⱼ − pᵢ of every edge.
    fn edges<T: Real>(&self, tape: &mut Tape<T>, positions: Var) -> Var {
        let ends = gather(tape, positions, self.neighbors.node_of_item());
        let starts = gather(tape, positions, &self.owner_of_edge);
        sub(tape, ends, starts)
    }

    /// The rotation of every edge: its owner's best.
    fn best_rotations<T: Real>(&self, before: &Tensor<T>, after: &Tensor<T>) -> Tensor<T> {
        let edges = before.rows();
        let mut rotations = Vec::with_capacity(4 * edges);
        for owner in 0..self.owner_of_edge.rows() {
            let mut correlation = [[0.0; 3]; 3];
            for &edge in self.owner_of_edge.items_of(owner) {
                let [from, to] = [before, after].map(|edges| vector(edges.row(edge as usize)));
                for (row, column) in (0..9).map(|at| (at / 3, at % 3)) {
                    correlation[row][column] += from[row] * to[column];
                }
            }
            let best = best_rotation(&correlation).map(T::from_f64);
            self.owner_of_edge.items_of(owner).iter().for_each(|_| rotations.extend(best));
        }
        Tensor::from_vec([edges, 4], rotations)
    }
}

fn vector<T: Real>(row: &[T]) -> [f64; 3] {
    [0, 1, 2].map(|axis| row[axis].to_f64())
}

/// The unit quaternion (w, x, y, z) that maximises Σ e'·Re for the correlation Σ e·e'ᵀ (Horn 1987): the leading eigenvector
/// of a symmetric matrix. Unlike a singular value decomposition it is never a reflection; without motion, and where nothing
/// says otherwise, it is the identity.
fn best_rotation(s: &[[f64; 3]; 3]) -> [f64; 4] {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *s;
    leading_eigenvector([
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ])
}

/// Sweeps of Jacobi's method: it converges quadratically, four or five reach the precision of f64.
const SWEEPS: usize = 8;

/// The unit eigenvector of the largest eigenvalue of a symmetric matrix: cyclic Jacobi rotations (Golub and Van Loan,
/// section 8.5).
fn leading_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut vectors = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
            let cosine = 1.0 / tangent.hypot(1.0);
            let turn = |x: f64, y: f64| (cosine * (x - tangent * y), cosine * (tangent * x + y));
            for row in a.iter_mut().chain(&mut vectors) {
                (row[p], row[q]) = turn(row[p], row[q]);
            }
            for (column, (x, y)) in a[p].into_iter().zip(a[q]).enumerate() {
                (a[p][column], a[q][column]) = turn(x, y);
            }
        }
    }
    let largest = (1..4).fold(0, |best, at| if a[at][at] > a[best][best] { at } else { best });
    vectors.map(|row| row[largest])
}

/// The published weight of the energy as a share of the first: 1 until iteration 5000, falling on a straight line in the
/// logarithm to 0.1 at 10 000, gone after 20 000.
pub fn published_decay(iteration: f64) -> f64 {
    let share = ((iteration - 5000.0) / 5000.0).clamp(0.0, 1.0);
    if iteration > 20_000.0 { 0.0 } else { 0.1_f64.powf(share) }
}
