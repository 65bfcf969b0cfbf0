//! The control nodes: their selection, their motion, and the Gaussians that follow them.

use shaders::arrays::rows::{RowIndex, concat_columns, gather};
use shaders::geometry::neighbor_blend::{Frames, Neighbors, blend, blend_frames, weights};
use shaders::pointwise::{add, scale, sub};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::Settings;
use crate::bases::canonical::{Moved, ScaleChanges, moved, scales_and_rotations};
use crate::bases::control_nodes::{NODES, TRANSLATION, identity_rotations};
use crate::bases::coordinate_mlp::{CoordinateMlp, Head};
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::layers::FirstWeights;
use crate::method::Moment;
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;

/// Output heads per node, with the published initial weights: motion is close to zero.
const ROTATION: Head = Head { name: "rotation", outputs: 4, first: FirstWeights::Normal(1e-5) };
const SCALE: Head = Head { name: "scale", outputs: 3, first: FirstWeights::Normal(1e-8) };
const FRAME: Head = Head { name: "frame", outputs: 4, first: FirstWeights::Normal(1e-4) };

/// Initial learnt coordinates of Gaussians and of nodes (published code).
const FIRST_FEATURES: [f64; 2] = [-1e-2, 1e-2];

/// The nodes and the network that moves them.
pub(crate) struct Nodes {
    settings: Settings,
    network: CoordinateMlp,
}

impl Nodes {
    /// Nodes with the method's settings.
    pub(crate) fn new(settings: &Settings) -> Self {
        let heads = [TRANSLATION, ROTATION, SCALE, FRAME];
        let network = CoordinateMlp::new("network", &settings.network, FirstWeights::He, &heads);
        Self { settings: settings.clone(), network }
    }

    /// The network that moves the nodes.
    pub(crate) fn network(&self) -> &CoordinateMlp {
        &self.network
    }

    /// Adds gates and learnt coordinates to the nodes.
    pub(crate) fn insert_gates_and_features<T: Real>(&self, state: &mut ModelState<T>) -> anyhow::Result<()> {
        let count = state.get("nodes.positions")?.rows();
        state.insert(format!("{NODES}.gates"), Tensor::zeros([count, 1]));
        if self.settings.features > 0 {
            let first = T::from_f64(FIRST_FEATURES[1]);
            state.insert(format!("{NODES}.features"), Tensor::full([count, self.settings.features], first));
        }
        Ok(())
    }

    /// Adds the learnt coordinates of the Gaussians.
    pub(crate) fn insert_gaussian_features<T: Real>(&self, state: &mut ModelState<T>) -> anyhow::Result<()> {
        let count = state.get("gaussians.positions")?.rows();
        if self.settings.features > 0 {
            let first = Tensor::full([count, self.settings.features], T::from_f64(FIRST_FEATURES[0]));
            state.insert(format!("{GAUSSIANS}.node_features"), first);
        }
        Ok(())
    }

    /// Learning rates of nodes, network and the Gaussians' learnt coordinates; the network has made `steps_before`
    /// steps of its schedule. The positions of nodes are not trained after the node stage.
    pub(crate) fn learning_rate(&self, tensor: &str, steps_before: u64) -> Option<LogLinear> {
        match tensor {
            "gaussians.node_features" => Some(LogLinear::constant(self.settings.feature_rate)),
            "nodes.positions" => None,
            tensor if belongs(tensor, NODES) => Some(self.settings.nodes.rate),
            _ => self.network.learning_rate(tensor).map(|law| law.after(steps_before)),
        }
    }

    /// The Gaussians at a moment: the frames of their nodes move them, and the nodes' blended changes are added. `rows`
    /// are the rows of these Gaussians in the model; `None` for all. The motion is constant with respect to a
    /// Gaussian's position, as published: the position receives the gradient of the moved position unchanged.
    pub(crate) fn carry<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        canonical: SplatVars,
        rows: Option<&RowIndex>,
        moment: &Moment<'_>,
    ) -> SplatVars {
        let positions = model.get("nodes.positions");
        let hidden = self.network.hidden(tape, model, positions, &[moment.time]);
        let [translations, growth] =
            [TRANSLATION, SCALE].map(|head| self.network.lengths(tape, model, head.name, hidden));
        let [turns, frame] = [ROTATION, FRAME].map(|head| self.network.head(tape, model, head.name, hidden));
        let held = tape.detach(canonical.positions);
        let (neighbors, weights) = self.weights(tape, model, held, rows, moment.scene.unit_world);
        let identity = identity_rotations(tape, tape.value(frame).rows());
        let rotations = add(tape, identity, frame);
        let frames = Frames { positions, translations, rotations };
        let carried = blend_frames(tape, weights, held, frames, &neighbors);
        let shift = sub(tape, carried, held);
        let carried = add(tape, canonical.positions, shift);
        let [turns, growth] = [turns, growth].map(|changes| blend(tape, weights, changes, &neighbors));
        let (_, rotations) = scales_and_rotations(&canonical);
        let rotations = add(tape, rotations, turns);
        let growth = ScaleChanges { changes: growth, unit_world: moment.scene.unit_world };
        moved(tape, canonical, Moved { positions: carried, rotations, scale_changes: Some(growth) })
    }

    /// The nodes of each Gaussian and their weights, nearest in position and learnt coordinates together; the latter are in
    /// units of `unit_world`.
    fn weights<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        gaussians: Var,
        rows: Option<&RowIndex>,
        unit_world: f64,
    ) -> (Neighbors, Var) {
        let nodes = model.get("nodes.positions");
        let (points, nodes) = match self.settings.features {
            0 => (gaussians, nodes),
            _ => {
                let all = model.get("gaussians.node_features");
                let features = rows.map_or(all, |rows| gather(tape, all, rows));
                let features =
                    [features, model.get("nodes.features")].map(|features| scale(tape, features, unit_world));
                let points = concat_columns(tape, &[gaussians, features[0]]);
                (points, concat_columns(tape, &[nodes, features[1]]))
            }
        };
        let neighbors = Neighbors::nearest(tape.value(points), tape.value(nodes), self.settings.nodes.per_gaussian);
        let (log_radii, gates) = (model.get("nodes.log_radii"), model.get("nodes.gates"));
        let weights = weights(tape, points, nodes, log_radii, Some(gates), &neighbors);
        (neighbors, weights)
    }
}
