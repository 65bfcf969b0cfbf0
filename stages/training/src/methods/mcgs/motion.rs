//! Node motion from a direct branch (a coordinate MLP of position and time), the Markov chain and their mixture, and its
//! application to the Gaussians. Equations are those of the MCGS paper.

use shaders::arrays::rows::{RowIndex, gather};
use shaders::geometry::neighbor_blend::{Neighbors, blend, weights};
use shaders::geometry::quaternion;
use shaders::pointwise::{add, mix};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::SHARES;
use super::markov::Chain;
use super::node_motion::{NETWORK, NodeMotion, Predictions};
use super::settings::{NodeSource, Settings};
use crate::bases::canonical::{Moved, moved, scales_and_rotations};
use crate::bases::control_nodes::{NODES, TRANSLATION, identity_rotations};
use crate::bases::coordinate_mlp::{CoordinateMlp, Head};
use crate::bases::layers::FirstWeights;
use crate::bases::static_mask;
use crate::data::{SceneFacts, Streams};
use crate::method::Moment;
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;

/// The second head of the direct branch, whose initial motion is close to zero.
const ROTATION: Head = Head { name: "rotation", outputs: 4, first: FirstWeights::Normal(1e-5) };

/// Number of times at which the error of the chain is measured.
const ERROR_TIMES: usize = 8;

/// The control nodes with both motion branches.
pub(crate) struct Nodes {
    settings: Settings,
    network: CoordinateMlp,
    chain: Chain,
}

impl Nodes {
    /// Nodes with the method's settings; the chain attends over its window if `attends`.
    pub(crate) fn new(settings: &Settings, attends: bool) -> Self {
        let heads = [TRANSLATION, ROTATION];
        let network = CoordinateMlp::new(NETWORK, &settings.network, FirstWeights::He, &heads);
        Self { settings: settings.clone(), network, chain: Chain::new(&settings.chain, attends) }
    }

    /// The network of the direct branch.
    pub(crate) fn network(&self) -> &CoordinateMlp {
        &self.network
    }

    /// Adds the tensors of the chain.
    pub(crate) fn insert_chain<T: Real>(&self, state: &mut ModelState<T>, random: Streams) {
        self.chain.insert(state, random);
    }

    /// Learning rates of nodes and branches. Nodes of the node stage keep their positions, as in SC-GS.
    pub(crate) fn learning_rate(&self, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let rate = self.settings.nodes.rate;
        let of_nodes = || match tensor {
            "nodes.positions" => {
                (self.settings.nodes_from == NodeSource::Gaussians).then(|| rate.scaled(scene.unit_world))
            }
            "nodes.log_radii" => Some(rate),
            _ => None,
        };
        let of_chain = || belongs(tensor, Chain::NAME).then_some(self.settings.network.rate);
        self.network.learning_rate(tensor).or_else(of_chain).or_else(of_nodes)
    }

    /// Both branches at times that follow each other by one frame interval.
    ///
    /// The history that the chain reads comes from the direct branch, not from earlier predictions of the chain, so that
    /// any time can be predicted on its own. No gradient flows into the history. Times before 0 repeat time 0.
    pub(crate) fn predict<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        times: &[f64],
        scene: &SceneFacts,
    ) -> Predictions {
        let before = self.chain.window();
        let first = times[0] - before as f64 * scene.training_interval();
        let earlier = (0..before).map(|at| (first + at as f64 * scene.training_interval()).max(0.0));
        let states: Vec<f64> = earlier.chain(times.iter().copied()).collect();
        let motion = self.direct(tape, model, &states);
        let nodes = tape.value(model.get("nodes.positions")).rows();
        let last_states = RowIndex::new(rows(before * nodes, times.len() * nodes), states.len() * nodes);
        let direct = NodeMotion {
            translations: gather(tape, motion.translations, &last_states),
            rotations: gather(tape, motion.rotations, &last_states),
        };
        let history =
            NodeMotion { translations: tape.detach(motion.translations), rotations: tape.detach(motion.rotations) };
        let chained = self.chain.predict(tape, model, history, nodes, times.len(), scene);
        Predictions { direct, chained }
    }

    /// The motion of the direct branch at every time.
    pub(crate) fn direct<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, times: &[f64]) -> NodeMotion {
        let hidden = self.network.hidden(tape, model, model.get("nodes.positions"), times);
        let translations = self.network.lengths(tape, model, TRANSLATION.name, hidden);
        let turns = self.network.head(tape, model, ROTATION.name, hidden);
        let identity = identity_rotations(tape, tape.value(turns).rows());
        let raw = add(tape, identity, turns);
        NodeMotion { translations, rotations: quaternion::normalize(tape, raw) }
    }

    /// The root mean square, over nodes and times, of the distance from the chain's positions to those of the direct branch,
    /// relative to that of the last states. 0: the chain predicts the motion within a frame; 1: it adds nothing to the last
    /// state. `None` without motion.
    pub(crate) fn chain_error<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
    ) -> Option<f64> {
        let mut squares = [0.0; 2];
        for at in 0..ERROR_TIMES {
            let time = (at as f64 + 0.5) / ERROR_TIMES as f64;
            let predicted = self.predict(tape, model, &[time], scene);
            let last = self.direct(tape, model, &[(time - scene.training_interval()).max(0.0)]);
            let truth = tape.value(predicted.direct.translations).as_slice();
            let squared = |found: Var| {
                let found = tape.value(found).as_slice();
                found.iter().zip(truth).map(|(found, truth)| (found.to_f64() - truth.to_f64()).powi(2)).sum::<f64>()
            };
            squares[0] += squared(predicted.chained.translations);
            squares[1] += squared(last.translations);
        }
        (squares[1] > 0.0).then(|| (squares[0] / squares[1]).sqrt())
    }

    /// (1 − λ)·direct + λ·chained, with one λ for translations and one for rotations, both set by the ramp; rotations are
    /// interpolated spherically (equations 10 and 11).
    pub(crate) fn mix<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, predictions: &Predictions) -> NodeMotion {
        let Predictions { direct, chained } = predictions;
        let shares = tape.value(model.get(SHARES)).as_slice().to_vec();
        let rows = tape.value(direct.rotations).rows();
        let of_rotation = tape.constant(Tensor::full([rows, 1], shares[1]));
        NodeMotion {
            translations: mix(tape, direct.translations, chained.translations, shares[0].to_f64()),
            rotations: quaternion::slerp(tape, direct.rotations, chained.rotations, of_rotation),
        }
    }

    /// Splits the motions of several times into one motion per time.
    pub(crate) fn split<T: Real>(&self, tape: &mut Tape<T>, motions: &NodeMotion, times: usize) -> Vec<NodeMotion> {
        let nodes = tape.value(motions.translations).rows() / times;
        let part = |time: usize| {
            let index = RowIndex::new(rows(time * nodes, nodes), times * nodes);
            let mut of_time = |var| gather(tape, var, &index);
            NodeMotion { translations: of_time(motions.translations), rotations: of_time(motions.rotations) }
        };
        (0..times).map(part).collect()
    }

    /// Moves the Gaussians that the static mask lets move with their nodes: x + Σ wₖ·Δμₖ and Δq⊗q, where Δq is the blend of the
    /// nodes' rotations.
    pub(crate) fn carry<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        moment: &Moment<'_>,
        canonical: SplatVars,
        motion: &NodeMotion,
    ) -> SplatVars {
        static_mask::move_some(tape, model, moment, canonical, |tape, some, _| {
            self.carry_all(tape, model, some, motion)
        })
    }

    fn carry_all<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        canonical: SplatVars,
        motion: &NodeMotion,
    ) -> SplatVars {
        let nodes = model.get(&format!("{NODES}.positions"));
        let log_radii = model.get(&format!("{NODES}.log_radii"));
        let (points, count) = (tape.detach(canonical.positions), self.settings.nodes.per_gaussian);
        let neighbors = Neighbors::nearest(tape.value(points), tape.value(nodes), count);
        let weights = weights(tape, points, nodes, log_radii, None, &neighbors);
        let shift = blend(tape, weights, motion.translations, &neighbors);
        // q and −q are the same rotation, but cancel in a sum.
        let identity = identity_rotations(tape, tape.value(motion.rotations).rows());
        let aligned = quaternion::align(tape, motion.rotations, identity);
        let sum = blend(tape, weights, aligned, &neighbors);
        let turn = quaternion::normalize(tape, sum);
        let (_, rotations) = scales_and_rotations(&canonical);
        let positions = add(tape, canonical.positions, shift);
        let rotations = quaternion::multiply(tape, turn, rotations);
        moved(tape, canonical, Moved { positions, rotations, scale_changes: None })
    }
}

/// The indices `first..first + count`.
fn rows(first: usize, count: usize) -> Vec<u32> {
    (first..first + count).map(|row| row as u32).collect()
}
