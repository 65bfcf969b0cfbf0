//! Control nodes: a few hundred points that move all Gaussians (Huang et al. 2024, SC-GS).
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `nodes.positions` | [M, 3] | canonical, scene units |
//! | `nodes.log_radii` | [M, 1] | logarithm of the reach, scene units |

mod node_stage;
mod rigidity;
mod selection;
#[cfg(test)]
mod tests;

#[cfg(test)]
pub(crate) use node_stage::SETTLE_NODES;
pub(crate) use node_stage::{NODE_PHASES, NodeStage, NodeStageSettings};
pub(crate) use rigidity::{Rigidity, add_rigidity, rigidity_left};
pub(crate) use selection::{farthest_points, sides};

use serde::{Deserialize, Serialize};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::coordinate_mlp::Head;
use crate::bases::layers::FirstWeights;
use crate::check::{Checks, Table, fields};
use crate::data::SceneFacts;
use crate::model::ModelState;
use crate::schedule::LogLinear;

/// The head of the network that translates nodes, with the published initial weights: motion is close to zero.
pub(crate) const TRANSLATION: Head = Head { name: "translation", outputs: 3, first: FirstWeights::Normal(1e-5) };

/// The population of nodes.
pub(crate) const NODES: &str = "nodes";

/// The number of nodes, their reach and their training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ControlNodeSettings {
    /// Number of nodes.
    pub count: usize,
    /// Number of nodes that each Gaussian follows.
    pub per_gaussian: usize,
    /// Initial reach of a node, as a share of the extent of all nodes: the longest side of their box after a node stage,
    /// otherwise its diagonal.
    pub first_radius: f64,
    /// Number of neighbours to which each node stays rigid.
    pub rigid_neighbors: usize,
    /// Learning rate.
    pub rate: LogLinear,
}

impl Default for ControlNodeSettings {
    fn default() -> Self {
        Self {
            count: 512,
            per_gaussian: 3,
            first_radius: 0.1,
            rigid_neighbors: 10,
            rate: LogLinear { start: 8e-4, end: 1.6e-6, steps: 40_000 },
        }
    }
}

/// Maximum nodes: every Gaussian is compared with every node, so a larger value is a typing error.
const MAX_NODES: usize = 65_536;

impl ControlNodeSettings {
    /// A few nodes.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self { count: 5, rigid_neighbors: 3, first_radius: 0.5, ..Self::default() }
    }
}

impl Table for ControlNodeSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .counts(MAX_NODES, fields!(self, count, per_gaussian, rigid_neighbors))
            .positive(fields!(self, first_radius))
            .table("rate", &self.rate)
    }
}

/// Smallest first reach of nodes, as a share of the scene's extent: coincident nodes and a single one need a reach, too.
const MIN_REACH: f64 = 1e-3;

/// Adds nodes at these positions [M, 3] with one reach, scene units.
pub(crate) fn insert_nodes<T: Real>(state: &mut ModelState<T>, positions: Tensor<T>, reach: f64, scene: &SceneFacts) {
    let reach = reach.max(MIN_REACH * scene.extent);
    let radii = Tensor::full([positions.rows(), 1], T::from_f64(reach.ln()));
    state.insert(format!("{NODES}.positions"), positions);
    state.insert(format!("{NODES}.log_radii"), radii);
}

/// The chosen rows of a tensor.
pub(crate) fn rows_of<T: Real>(tensor: &Tensor<T>, chosen: &[usize]) -> Tensor<T> {
    let values = chosen.iter().flat_map(|&row| tensor.row(row)).copied().collect();
    Tensor::from_vec([&[chosen.len()], &tensor.shape()[1..]].concat(), values)
}

/// Identity quaternions (1, 0, 0, 0), one per row.
pub(crate) fn identity_rotations<T: Real>(tape: &mut Tape<T>, rows: usize) -> Var {
    let identity = [T::ONE, T::ZERO, T::ZERO, T::ZERO];
    tape.constant(Tensor::from_vec([rows, 4], identity.repeat(rows)))
}
