//! The Markov chain: encodes the last states of every node, attends over them and predicts the next step (equations 3
//! to 5, 14 and 15).

use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{RowIndex, columns, concat_columns, gather, reshape};
use shaders::geometry::quaternion;
use shaders::networks::attention::window_attention;
use shaders::networks::layer_norm::layer_norm;
use shaders::networks::linear::Activation;
use shaders::pointwise::{add, relu, scale};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::node_motion::{NETWORK, NodeMotion};
use crate::bases::bounds;
use crate::bases::control_nodes::identity_rotations;
use crate::bases::layers::{FirstWeights, apply_layer, apply_matrix, insert_layer, insert_matrix, normal};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::model::{ModelState, Variables};

/// Columns of a state: position and quaternion.
const STATE: usize = 7;

/// Initial standard deviation of the time embedding within the window, of the order of the encoder's outputs. The
/// states of one window are nearly equal, so the attention could not distinguish them by a smaller embedding.
const FIRST_EMBEDDING: f64 = 0.5;

/// Sizes of the Markov chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ChainSettings {
    /// Number of previous states in the window.
    pub window: usize,
    /// Width of the encoder, the attention and the predictor.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Whether the attention receives an embedding of the age of each state.
    pub embeds_time: bool,
}

impl Default for ChainSettings {
    fn default() -> Self {
        Self { window: 5, width: 128, heads: 4, embeds_time: true }
    }
}

impl Table for ChainSettings {
    fn check(&self) -> Checks {
        let checks = Checks::default().counts(1024, fields!(self, window)).counts(4096, fields!(self, width));
        let divides = self.heads > 0 && self.width.is_multiple_of(self.heads);
        checks.require("heads", divides, "must divide width")
    }
}

/// Encoder, attention and predictor of the chain; its tensors are named `chain.…`.
pub(crate) struct Chain {
    settings: ChainSettings,
    attends: bool,
}

impl Chain {
    /// Prefix of the chain's tensor names.
    pub(crate) const NAME: &'static str = "chain";

    /// A chain that attends over its window if `attends`; otherwise it reads only the last state.
    pub(crate) fn new(settings: &ChainSettings, attends: bool) -> Self {
        Self { settings: settings.clone(), attends }
    }

    /// Number of previous states that a prediction reads.
    pub(crate) fn window(&self) -> usize {
        if self.attends { self.settings.window } else { 1 }
    }

    /// Adds all layers. The predictor's last layer starts at zero, so that nodes initially keep their last state.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, random: Streams) {
        let width = self.settings.width;
        for (layer, inputs) in [STATE, width].into_iter().enumerate() {
            insert_layer(state, &format!("chain.encoder.{layer}"), inputs, width, FirstWeights::FanIn, random);
            state.insert(format!("chain.encoder.{layer}.scale"), Tensor::full([width], T::ONE));
            state.insert(format!("chain.encoder.{layer}.offset"), Tensor::zeros([width]));
        }
        if self.attends {
            for map in ["query", "key", "value", "output"] {
                insert_matrix(state, &format!("chain.{map}"), width, width, random);
            }
            if self.settings.embeds_time {
                let time = normal(&[self.window(), width], FIRST_EMBEDDING, &mut random.tensor("chain.time"));
                state.insert("chain.time", time);
            }
        }
        for layer in 0..2 {
            insert_layer(state, &format!("chain.predictor.{layer}"), width, width, FirstWeights::FanIn, random);
        }
        insert_layer(state, "chain.predictor.2", width, STATE, FirstWeights::Zero, random);
    }

    /// Predicts the motion of M nodes at `times` times from the states before each. `history` holds ([`Chain::window`]
    /// + times)·M rows, state by state; its last state is not read. The result has times·M rows.
    ///
    /// A prediction is the last state plus the predicted step (equations 5, 12 and 13): Δμ + δμ and Δq⊗δq, where δq is
    /// (1, 0, 0, 0) + δ, normalised.
    ///
    /// The network outputs steps in units of one frame's share of the capture's duration, and lengths in scene extents:
    /// the motion within a frame is small, and unscaled outputs of the order of 1 would move nodes across the whole
    /// scene.
    pub(crate) fn predict<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        history: NodeMotion,
        nodes: usize,
        times: usize,
        scene: &SceneFacts,
    ) -> NodeMotion {
        let states = self.window() + times;
        let part = |tape: &mut Tape<T>, var: Var, first: usize, count: usize| {
            let rows = (first * nodes..(first + count) * nodes).map(|row| row as u32).collect();
            gather(tape, var, &RowIndex::new(rows, states * nodes))
        };
        let last = self.window() - 1;
        let seen = match self.attends {
            true => {
                let encoded = self.encode(tape, model, history, nodes);
                self.attend(tape, model, encoded, nodes, times)
            }
            false => {
                let newest = NodeMotion {
                    translations: part(tape, history.translations, last, times),
                    rotations: part(tape, history.rotations, last, times),
                };
                self.encode(tape, model, newest, nodes)
            }
        };
        let steps = self.step(tape, model, seen);
        let (shift, turn) = (columns(tape, steps, 0..3), columns(tape, steps, 3..STATE));
        let shift = scale(tape, shift, scene.extent * scene.training_interval());
        let turn = scale(tape, turn, scene.training_interval());
        let identity = identity_rotations(tape, times * nodes);
        let raw = add(tape, identity, turn);
        let turn = quaternion::normalize(tape, raw);

        let translations = part(tape, history.translations, last, times);
        let rotations = part(tape, history.rotations, last, times);
        NodeMotion {
            translations: add(tape, translations, shift),
            rotations: quaternion::multiply(tape, rotations, turn),
        }
    }

    /// h = MLP([μ, q]) of every state (equation 3). μ is relative to the scene's box; the sign of q is chosen on the
    /// side of the identity, because q and −q would be encoded differently.
    fn encode<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, history: NodeMotion, nodes: usize) -> Var {
        let rows = tape.value(history.translations).rows();
        let canonical = tape.detach(model.get("nodes.positions"));
        let node_of_row = RowIndex::new((0..rows).map(|row| (row % nodes) as u32).collect(), nodes);
        let canonical = gather(tape, canonical, &node_of_row);
        let positions = add(tape, canonical, history.translations);
        let positions = bounds::inside(tape, model, NETWORK, positions);
        let identity = identity_rotations(tape, rows);
        let rotations = quaternion::align(tape, history.rotations, identity);
        let mut hidden = concat_columns(tape, &[positions, rotations]);
        for layer in 0..2 {
            let name = format!("chain.encoder.{layer}");
            let mapped = apply_layer(tape, model, &name, hidden, Activation::Identity);
            let [scale, offset] = ["scale", "offset"].map(|part| model.get(&format!("{name}.{part}")));
            let normalised = layer_norm(tape, mapped, scale, offset);
            hidden = relu(tape, normalised);
        }
        hidden
    }

    /// Attention of the newest state over the window, for every node and time (equations 14 and 15).
    fn attend<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, encoded: Var, nodes: usize, times: usize) -> Var {
        let (window, width) = (self.window(), self.settings.width);
        let windows = times * nodes;
        // Attention row (time, node, state of the window) reads encoded row (time + state, node).
        let items = 0..windows * window;
        let row_of_item = items.clone().map(|item| {
            let (at, state) = (item / window, item % window);
            ((at / nodes + state) * nodes + at % nodes) as u32
        });
        let mut seen = gather(tape, encoded, &RowIndex::new(row_of_item.collect(), (window + times) * nodes));
        if self.settings.embeds_time {
            let state_of_item = RowIndex::new(items.map(|item| (item % window) as u32).collect(), window);
            let ages = gather(tape, model.get("chain.time"), &state_of_item);
            seen = add(tape, seen, ages);
        }
        let newest = (0..windows).map(|at| (at * window + window - 1) as u32).collect();
        let newest = gather(tape, seen, &RowIndex::new(newest, windows * window));
        let query = apply_matrix(tape, model, "chain.query", newest);
        let query = reshape(tape, query, [windows, 1, width]);
        let [key, value] = ["chain.key", "chain.value"].map(|name| {
            let mapped = apply_matrix(tape, model, name, seen);
            reshape(tape, mapped, [windows, window, width])
        });
        let attended = window_attention(tape, query, key, value, self.settings.heads);
        let attended = reshape(tape, attended, [windows, width]);
        apply_matrix(tape, model, "chain.output", attended)
    }

    /// MLP_φ, three layers: the predicted step (equation 5).
    fn step<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, seen: Var) -> Var {
        let first = apply_layer(tape, model, "chain.predictor.0", seen, Activation::Relu);
        let second = apply_layer(tape, model, "chain.predictor.1", first, Activation::Relu);
        apply_layer(tape, model, "chain.predictor.2", second, Activation::Identity)
    }
}
