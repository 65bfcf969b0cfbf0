//! The control nodes: their selection, their motion, and the Gaussians that follow them.

use rand::RngExt as _;
use scene::cloud::PointCloud;
use shaders::arrays::rows::{RowIndex, concat_columns, gather};
use shaders::geometry::neighbor_blend::{Frames, Neighbors, blend, blend_frames, weights};
use shaders::pointwise::add;
use shaders::rasteriser::SplatVars;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::{CANDIDATES, Settings};
use crate::bases::canonical::{Moved, moved, scales_and_rotations};
use crate::bases::control_nodes::{NODES, Rigidity, farthest_points, identity_rotations, insert_nodes, rows_of, sides};
use crate::bases::coordinate_mlp::{CoordinateMlp, Head};
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::layers::FirstWeights;
use crate::data::Streams;
use crate::method::Step;
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;

/// Output heads per node, with the published initial weights: motion is close to zero.
const TRANSLATION: Head = Head { name: "translation", outputs: 3, first: FirstWeights::Normal(1e-5) };
const ROTATION: Head = Head { name: "rotation", outputs: 4, first: FirstWeights::Normal(1e-5) };
const SCALE: Head = Head { name: "scale", outputs: 3, first: FirstWeights::Normal(1e-8) };
const FRAME: Head = Head { name: "frame", outputs: 4, first: FirstWeights::Normal(1e-4) };

/// Initial learnt coordinates of Gaussians and of nodes (published code).
const FIRST_FEATURES: [f64; 2] = [-1e-2, 1e-2];

/// Number of times at which the candidates' paths are compared.
const PATH_TIMES: usize = 16;

/// Maximum distance of the two times of the rigidity loss, as a share of the clip (published code).
const RIGID_SPAN: f64 = 0.05;

/// Maximum number of nodes or candidates in the rigidity loss (published code).
const MOST_RIGID: usize = 512;

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

    /// Adds the network for a scene with these points.
    pub(crate) fn insert_network<T: Real>(&self, state: &mut ModelState<T>, points: &PointCloud, random: Streams) {
        self.network.insert(state, points, random);
    }

    /// Selects the candidates with the most distant paths through time as nodes (farthest-point sampling) and drops the
    /// rest.
    pub(crate) fn choose<T: Real>(&self, candidates: ModelState<T>) -> anyhow::Result<ModelState<T>> {
        let positions = candidates.get("candidates.positions")?.clone();
        let chosen = farthest_points(&self.paths(&candidates, &positions), self.settings.nodes.count);
        let mut state = ModelState::new();
        let kept = candidates.into_iter().filter(|(name, _)| !belongs(name, CANDIDATES));
        kept.for_each(|(name, tensor)| state.insert(name, tensor));
        let positions = rows_of(&positions, &chosen);
        let size = sides(&positions).into_iter().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let count = positions.rows();
        insert_nodes(&mut state, positions, self.settings.nodes.first_radius * size);
        state.insert(format!("{NODES}.gates"), Tensor::zeros([count, 1]));
        if self.settings.features > 0 {
            let first = T::from_f64(FIRST_FEATURES[1]);
            state.insert(format!("{NODES}.features"), Tensor::full([count, self.settings.features], first));
        }
        Ok(state)
    }

    /// Positions of every candidate at several times, side by side: [N, 3·times].
    fn paths<T: Real>(&self, state: &ModelState<T>, positions: &Tensor<T>) -> Tensor<T> {
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let canonical = model.get("candidates.positions");
        let places = (0..PATH_TIMES).map(|at| at as f64 / (PATH_TIMES - 1) as f64).map(|time| {
            let shift = self.translations(&mut tape, &model, canonical, &[time]);
            add(&mut tape, canonical, shift)
        });
        let places: Vec<Var> = places.collect();
        let joined = concat_columns(&mut tape, &places);
        assert_eq!(tape.value(joined).rows(), positions.rows());
        tape.value(joined).clone()
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

    /// Learning rates of the candidates' network; heads that do not move candidates are not trained.
    pub(crate) fn learning_rate_among_candidates(&self, tensor: &str) -> Option<LogLinear> {
        let is_idle = |head: &Head| belongs(tensor, &format!("network.{}", head.name));
        let rate = self.network.learning_rate(tensor)?;
        (![ROTATION, SCALE, FRAME].iter().any(is_idle)).then_some(rate)
    }

    /// Learning rates of nodes and network; until `with_nodes`, only the Gaussians' learnt coordinates are trained.
    pub(crate) fn learning_rate(&self, tensor: &str, with_nodes: bool, steps_before: u64) -> Option<LogLinear> {
        if tensor == "gaussians.node_features" {
            return Some(LogLinear::constant(self.settings.feature_rate));
        }
        let of_nodes = || belongs(tensor, NODES).then_some(self.settings.nodes.rate);
        let rate = self.network.learning_rate(tensor).map(|law| law.after(steps_before)).or_else(of_nodes)?;
        with_nodes.then_some(rate)
    }

    /// Displacements that the network predicts for positions [N, 3] at each of the times: [T·N, 3], time by time.
    pub(crate) fn translations<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        positions: Var,
        times: &[f64],
    ) -> Var {
        let hidden = self.network.hidden(tape, model, positions, times);
        self.network.lengths(tape, model, TRANSLATION.name, hidden)
    }

    /// The Gaussians at a time: the frames of their nodes move them, and the nodes' blended changes are added. `rows`
    /// are the rows of these Gaussians in the model; `None` for all.
    pub(crate) fn carry<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        canonical: SplatVars,
        rows: Option<&RowIndex>,
        time: f64,
    ) -> SplatVars {
        let positions = model.get("nodes.positions");
        let hidden = self.network.hidden(tape, model, positions, &[time]);
        let [translations, growth] =
            [TRANSLATION, SCALE].map(|head| self.network.lengths(tape, model, head.name, hidden));
        let [turns, frame] = [ROTATION, FRAME].map(|head| self.network.head(tape, model, head.name, hidden));
        let (neighbors, weights) = self.weights(tape, model, canonical.positions, rows);
        let identity = identity_rotations(tape, tape.value(frame).rows());
        let rotations = add(tape, identity, frame);
        let frames = Frames { positions, translations, rotations };
        let carried = blend_frames(tape, weights, canonical.positions, frames, &neighbors);
        let [turns, growth] = [turns, growth].map(|changes| blend(tape, weights, changes, &neighbors));
        let (_, rotations) = scales_and_rotations(&canonical);
        let rotations = add(tape, rotations, turns);
        moved(tape, canonical, Moved { positions: carried, rotations, scale_changes: Some(growth) })
    }

    /// The nodes of each Gaussian and their weights, nearest in position and learnt coordinates together.
    fn weights<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        gaussians: Var,
        rows: Option<&RowIndex>,
    ) -> (Neighbors, Var) {
        let nodes = model.get("nodes.positions");
        let (points, nodes) = match self.settings.features {
            0 => (gaussians, nodes),
            _ => {
                let all = model.get("gaussians.node_features");
                let features = rows.map_or(all, |rows| gather(tape, all, rows));
                let points = concat_columns(tape, &[gaussians, features]);
                (points, concat_columns(tape, &[nodes, model.get("nodes.features")]))
            }
        };
        let neighbors = Neighbors::nearest(tape.value(points), tape.value(nodes), self.settings.nodes.per_gaussian);
        let (log_radii, gates) = (model.get("nodes.log_radii"), model.get("nodes.gates"));
        let weights = weights(tape, points, nodes, log_radii, Some(gates), &neighbors);
        (neighbors, weights)
    }

    /// Adds the rigidity of nodes, or of candidates, between two close times.
    pub(crate) fn add_rigidity<T: Real>(&self, step: &mut Step<'_, T>, population: &str, weight: f64) {
        if weight == 0.0 {
            return;
        }
        let random = step.random.of("rigidity");
        let first = random.random::<f64>() * (1.0 - RIGID_SPAN);
        let second = first + random.random::<f64>() * RIGID_SPAN;
        let population = if population == CANDIDATES { CANDIDATES } else { NODES };
        let positions = self.evenly(step.tape, step.model.get(&format!("{population}.positions")));
        let per_node = self.settings.nodes.rigid_neighbors;
        let Some(rigidity) = Rigidity::new(step.tape.value(positions), per_node) else { return };
        let [before, after] = [first, second].map(|time| {
            let shift = self.translations(step.tape, step.model, positions, &[time]);
            add(step.tape, positions, shift)
        });
        let energy = rigidity.energy(step.tape, before, after);
        step.add_loss("rigidity", weight, energy);
    }

    /// At most [`MOST_RIGID`] of the rows, evenly chosen.
    fn evenly<T: Real>(&self, tape: &mut Tape<T>, positions: Var) -> Var {
        let rows = tape.value(positions).rows();
        if rows <= MOST_RIGID {
            return positions;
        }
        let chosen = (0..MOST_RIGID).map(|at| (at * rows / MOST_RIGID) as u32).collect();
        gather(tape, positions, &RowIndex::new(chosen, rows))
    }
}
