//! As-rigid-as-possible motion (Sorkine and Alexa 2007): neighbourhoods may move and turn, but should not stretch.

use rand::RngExt as _;
use shaders::arrays::rows::{RowIndex, gather, keep_rows, squared_norm};
use shaders::arrays::totals::total;
use shaders::geometry::neighbor_blend::Neighbors;
use shaders::geometry::quaternion;
use shaders::pointwise;
use shaders::pointwise::{add, square, sub};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::TRANSLATION;
use crate::bases::coordinate_mlp::CoordinateMlp;
use crate::data::evenly_thinned;
use crate::method::Step;
use crate::schedule::WARM_UP;
use crate::shared::Shared;

/// Number of nearest nodes to which a node stays rigid at any distance (published code).
const ALWAYS_RIGID: usize = 3;
/// Maximum length of the other edges, in units of published constants (published code).
const REACH: f64 = 0.1;
/// Duration, as a share of the clip, that contains both moments of the loss (published code).
const RIGID_SPAN: f64 = 0.05;
/// Maximum number of nodes or candidates in the loss (published code).
const MOST_RIGID: usize = 512;

/// Pairs of nodes that stay rigid to each other.
pub(crate) struct Rigidity {
    neighbors: Neighbors,
    owner_of_edge: RowIndex,
    reach: f64,
}

impl Rigidity {
    /// Edges from each node to its `per_node` nearest nodes at the current positions [M, D]; `None` for a single node.
    /// Beyond the three nearest nodes, an edge counts only while it is shorter than [`REACH`]·`unit`, where `unit` is
    /// the unit of the published constants in scene units.
    pub(crate) fn new<T: Real>(positions: &Tensor<T>, per_node: usize, unit: f64) -> Option<Self> {
        let neighbors = Neighbors::nearest_others(positions, per_node);
        let per_node = neighbors.per_point();
        if per_node == 0 {
            return None;
        }
        let owners = (0..positions.rows() * per_node).map(|edge| (edge / per_node) as u32).collect();
        Some(Self { neighbors, owner_of_edge: RowIndex::new(owners, positions.rows()), reach: REACH * unit })
    }

    /// Σ ‖(p'ⱼ − p'ᵢ) − Rᵢ(pⱼ − pᵢ)‖² over all edges from i to j, shape [1], between positions p and p' [M, 3] of two
    /// moments.
    ///
    /// Rᵢ is the rotation that fits the edges of i best. It is held constant, because the derivative with respect to
    /// the optimal rotation vanishes.
    pub(crate) fn energy<T: Real>(&self, tape: &mut Tape<T>, before: Var, after: Var) -> Var {
        let edges = [before, after].map(|positions| self.edges(tape, positions));
        let counts = self.counted(tape, edges[0]);
        let [edges_before, edges_after] = edges.map(|edges| keep_rows(tape, edges, counts));
        let rotations = quaternion::best_rotations(tape, edges_before, edges_after, self.neighbors.per_point());
        let turned = quaternion::rotate(tape, rotations, edges_before);
        let stretch = sub(tape, edges_after, turned);
        let squares = square(tape, stretch);
        total(tape, squares)
    }

    /// 1 for every edge that counts, otherwise 0: [edges, 1].
    fn counted<T: Real>(&self, tape: &mut Tape<T>, edges: Var) -> Var {
        let per_node = self.neighbors.per_point();
        let rows = tape.value(edges).rows();
        let is_near = |edge: usize| if edge % per_node < ALWAYS_RIGID { T::ONE } else { T::ZERO };
        let near = tape.constant(Tensor::from_vec([rows, 1], (0..rows).map(is_near).collect()));
        let held = tape.detach(edges);
        let lengths = squared_norm(tape, held);
        one_if_within(tape, lengths, near, self.reach * self.reach)
    }

    /// pⱼ − pᵢ of every edge.
    fn edges<T: Real>(&self, tape: &mut Tape<T>, positions: Var) -> Var {
        let ends = gather(tape, positions, self.neighbors.node_of_item());
        let starts = gather(tape, positions, &self.owner_of_edge);
        sub(tape, ends, starts)
    }
}

/// Adds the rigidity loss of nodes, or of candidates, between two random times at most [`RIGID_SPAN`] apart, with
/// lengths in units of `unit_world`. The canonical `positions` are detached: the loss trains the network only.
pub(crate) fn add_rigidity<T: Real>(
    step: &mut Step<'_, T>,
    network: &CoordinateMlp,
    positions: Var,
    per_node: usize,
    weight: f64,
) {
    if weight == 0.0 {
        return;
    }
    let random = step.random.of("rigidity");
    let middle = random.random::<f64>();
    let times = [(); 2].map(|()| middle + RIGID_SPAN * (random.random::<f64>() - 0.5));
    let held = step.tape.detach(positions);
    let held = evenly(step.tape, held);
    let [before, after] = times.map(|time| {
        let hidden = network.hidden(step.tape, step.model, held, &[time]);
        let shift = network.lengths(step.tape, step.model, TRANSLATION.name, hidden);
        add(step.tape, held, shift)
    });
    let unit = step.scene.unit_world;
    let Some(rigidity) = Rigidity::new(step.tape.value(before), per_node, unit) else { return };
    let energy = rigidity.energy(step.tape, before, after);
    step.add_loss("rigidity", weight / (unit * unit), energy);
}

/// At most [`MOST_RIGID`] of the rows, evenly chosen.
fn evenly<T: Real>(tape: &mut Tape<T>, positions: Var) -> Var {
    let rows = tape.value(positions).rows();
    if rows <= MOST_RIGID {
        return positions;
    }
    let chosen = evenly_thinned((0..rows as u32).collect(), MOST_RIGID);
    gather(tape, positions, &RowIndex::new(chosen, rows))
}

pointwise! {
    /// y = 1 where x < limit, elsewhere `otherwise`.
    fn one_if_within(x, otherwise) with(limit) -> y {
        return select(otherwise, 1.0, x < limit);
    }
    gradients(dy) {
        x: { return 0.0 * dy; }
        otherwise: { return select(dy, 0.0, x < limit); }
    }
}

/// The weight of the energy in step `iteration` of the phase after the warm-up, relative to the initial one, as
/// published: 1 until iteration 5000, log-linear decay to 0.1 at 10 000, constant until 20 000, then 0. These
/// iterations include the warm-up and are those of the unstretched schedule.
pub(crate) fn rigidity_left(shared: &Shared, iteration: u64) -> f64 {
    let unstretched = iteration as f64 / shared.schedule_scale + shared.iterations_of(WARM_UP) as f64;
    let share = ((unstretched - 5000.0) / 5000.0).clamp(0.0, 1.0);
    if unstretched > 20_000.0 { 0.0 } else { 0.1_f64.powf(share) }
}
