//! The node stage of SC-GS (Huang et al. 2024, section 4.2): candidates for nodes are isotropic Gaussians of one size
//! that the coordinate network moves, so that they gather on moving objects. Farthest-point sampling of their paths
//! selects the nodes.

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{concat_columns, repeat_row};
use shaders::arrays::totals::mean;
use shaders::pointwise::add;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::{ControlNodeSettings, TRANSLATION, add_rigidity, farthest_points, insert_nodes, rows_of, sides};
use crate::bases::canonical::{position_rate, scales_and_rotations};
use crate::bases::coordinate_mlp::CoordinateMlp;
use crate::bases::gaussians::{self, AdaptiveDensity};
use crate::bases::random_background::recomposed;
use crate::bases::time_noise::TimeNoise;
use crate::check::{Checks, Table, fields};
use crate::data::SceneFacts;
use crate::method::{Moment, Observed, Step, StepHook};
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::{LogLinear, Phase, stretch};
use crate::shared::{Density, Shared};

/// The population of candidates.
const CANDIDATES: &str = "candidates";
/// The phase that places the candidates, without motion. If they moved from the first step on, the network would learn
/// to move all of them out of the image, because random points are worse than an empty background.
pub(crate) const PLACE_CANDIDATES: &str = "place-candidates";
/// The phase in which candidates move.
pub(crate) const CHOOSE_NODES: &str = "choose-nodes";
/// The phase in which the chosen candidates find their final positions.
pub(crate) const SETTLE_NODES: &str = "settle-nodes";
/// The phases of the stage and their published iterations.
pub(crate) const NODE_PHASES: [(&str, u64); 3] = [(PLACE_CANDIDATES, 2000), (CHOOSE_NODES, 5500), (SETTLE_NODES, 2500)];

/// Number of times at which the candidates' paths are compared.
const PATH_TIMES: usize = 16;

/// The candidates of the node stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct NodeStageSettings {
    /// Number of initial candidates, points that lie far apart.
    pub candidates: usize,
    /// Maximum number of candidates.
    pub max_candidates: usize,
    /// Weight of the rigidity of candidates.
    pub rigidity: f64,
}

impl Default for NodeStageSettings {
    fn default() -> Self {
        Self { candidates: 512, max_candidates: 8192, rigidity: 1e-2 }
    }
}

impl Table for NodeStageSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .at_least_one(fields!(self, candidates))
            .require("max_candidates", self.max_candidates >= self.candidates, "must be at least candidates")
            .not_negative(fields!(self, rigidity))
    }
}

/// The node stage of a method whose network has the head [`TRANSLATION`].
pub(crate) struct NodeStage {
    shared: Shared,
    settings: NodeStageSettings,
    nodes: ControlNodeSettings,
    network: CoordinateMlp,
    is_rigid: bool,
    time_noise: Option<TimeNoise>,
}

impl NodeStage {
    /// The stage before a training with these nodes and this network.
    pub(crate) fn new(
        shared: &Shared,
        settings: &NodeStageSettings,
        nodes: &ControlNodeSettings,
        network: &CoordinateMlp,
        is_rigid: bool,
    ) -> Self {
        Self {
            shared: shared.clone(),
            settings: settings.clone(),
            nodes: nodes.clone(),
            network: network.clone(),
            is_rigid,
            time_noise: None,
        }
    }

    /// The stage with noise on the times of its views.
    pub(crate) fn with_noise(self, time_noise: Option<TimeNoise>) -> Self {
        Self { time_noise, ..self }
    }

    /// Whether a phase belongs to the stage.
    pub(crate) fn has(phase: &str) -> bool {
        NODE_PHASES.iter().any(|(name, _)| *name == phase)
    }

    /// The phases of the stage; without iterations if it is not `active`.
    pub(crate) fn phases(shared: &Shared, active: bool) -> Vec<Phase> {
        let phase = |(name, _)| if active { shared.phase(name) } else { Phase { name, iterations: 0 } };
        NODE_PHASES.map(phase).to_vec()
    }

    /// Adds candidates at points that lie far apart.
    pub(crate) fn insert_candidates<T: Real>(
        &self,
        state: &mut ModelState<T>,
        scene: &SceneFacts,
        points: &PointCloud,
    ) {
        let all = points.positions.iter().flatten().copied().collect();
        let chosen = farthest_points(&Tensor::<f32>::from_vec([points.len(), 3], all), self.settings.candidates);
        let points = PointCloud {
            positions: chosen.iter().map(|&at| points.positions[at]).collect(),
            colors: chosen.iter().map(|&at| points.colors[at]).collect(),
        };
        gaussians::insert_gaussians(state, CANDIDATES, &points, 0, scene);
    }

    /// The state at the start of a phase: [`SETTLE_NODES`] keeps the candidates with the most distant paths through
    /// time (farthest-point sampling), and `after_stage`, the first phase after the stage, turns them into nodes.
    pub(crate) fn enter_phase<T: Real>(
        &self,
        phase: &str,
        after_stage: &str,
        state: ModelState<T>,
        scene: &SceneFacts,
    ) -> anyhow::Result<ModelState<T>> {
        match phase {
            SETTLE_NODES => self.keep_chosen(state),
            phase if phase == after_stage => self.nodes_of(state, scene),
            _ => Ok(state),
        }
    }

    fn keep_chosen<T: Real>(&self, candidates: ModelState<T>) -> anyhow::Result<ModelState<T>> {
        let chosen = farthest_points(&self.paths(&candidates)?, self.nodes.count);
        let mut state = ModelState::new();
        for (name, tensor) in candidates.into_iter() {
            let kept = if belongs(&name, CANDIDATES) { rows_of(&tensor, &chosen) } else { tensor };
            state.insert(name, kept);
        }
        Ok(state)
    }

    fn nodes_of<T: Real>(&self, candidates: ModelState<T>, scene: &SceneFacts) -> anyhow::Result<ModelState<T>> {
        let positions = candidates.get("candidates.positions")?.clone();
        let mut state = ModelState::new();
        let others = candidates.into_iter().filter(|(name, _)| !belongs(name, CANDIDATES));
        others.for_each(|(name, tensor)| state.insert(name, tensor));
        let size = sides(&positions).into_iter().fold(0.0, f64::max);
        insert_nodes(&mut state, positions, self.nodes.first_radius * size, scene);
        Ok(state)
    }

    /// Positions of every candidate at several times, side by side: [N, 3·times].
    fn paths<T: Real>(&self, state: &ModelState<T>) -> anyhow::Result<Tensor<T>> {
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let canonical = model.find("candidates.positions").ok_or_else(|| anyhow::anyhow!("no candidates"))?;
        let times = (0..PATH_TIMES).map(|at| at as f64 / (PATH_TIMES - 1) as f64);
        let places: Vec<Var> = times.map(|time| self.moved(&mut tape, &model, canonical, time)).collect();
        let joined = concat_columns(&mut tape, &places);
        Ok(tape.value(joined).clone())
    }

    fn moved<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var, time: f64) -> Var {
        let hidden = self.network.hidden(tape, model, positions, &[time]);
        let shift = self.network.lengths(tape, model, TRANSLATION.name, hidden);
        add(tape, positions, shift)
    }

    /// Learning rates in a phase of the stage. Isotropic Gaussians have no rotation to train, and the network is trained
    /// where it moves candidates; its schedule counts the steps of the whole stage.
    pub(crate) fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let before = self.steps_before(phase);
        match tensor {
            "candidates.positions" => Some(position_rate(&self.shared.learning_rates, scene).after(before)),
            "candidates.rotations" => None,
            tensor if belongs(tensor, CANDIDATES) => {
                gaussians::learning_rate(&self.shared.learning_rates, CANDIDATES, tensor, scene)
            }
            tensor if phase != PLACE_CANDIDATES && self.network.reaches(tensor, TRANSLATION.name) => {
                Some(self.network.learning_rate(tensor)?.after(before))
            }
            _ => None,
        }
    }

    /// Steps of the stage before a phase, before stretching.
    fn steps_before(&self, phase: &str) -> u64 {
        let before = NODE_PHASES.iter().take_while(|(name, _)| *name != phase);
        before.map(|(name, _)| self.shared.iterations_of(name)).sum()
    }

    /// The candidates at a moment: their constant colours, one size for all, at moved positions once they move.
    pub(crate) fn splats<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> SplatVars {
        let canonical = gaussians::static_splats(tape, model, CANDIDATES, 0);
        let count = tape.value(canonical.positions).rows();
        let positions = match moment.phase {
            PLACE_CANDIDATES => canonical.positions,
            _ => self.moved(tape, model, canonical.positions, moment.time),
        };
        let (log_scales, rotations) = scales_and_rotations(&canonical);
        let common = mean(tape, log_scales);
        let common = repeat_row(tape, common, count);
        let log_scales = concat_columns(tape, &[common; 3]);
        // Renders use the degree of the schedule.
        let higher = tape.constant(Tensor::zeros([count, (moment.sh_degree + 1).pow(2) - 1, 3]));
        let sh = gaussians::active_harmonics(tape, canonical.sh, higher, moment.sh_degree);
        SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, sh, ..canonical }
    }

    /// The losses of a step: photometric, on random backgrounds where the coverage is known, and rigidity.
    pub(crate) fn losses<T: Real>(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let views = step.views;
        for view in views {
            step.clock.enter("motion");
            let noisy = self.time_noise.map(|noise| noise.time(step, view, self.steps_before(step.phase)));
            let moment = Moment { time: noisy.unwrap_or(view.time), ..step.moment(view) };
            let splats = self.splats(step.tape, step.model, &moment);
            let known = recomposed(step, view)?;
            step.raster.background = known.as_ref().map_or(step.scene.background, |known| known.background);
            let rendered = step.render(&splats, None, view, Observed::All(CANDIDATES))?;
            match known {
                Some(known) => step.photometric_to(1.0, rendered.color, known.image),
                None => step.photometric(1.0, rendered.color, view),
            }
        }
        if self.is_rigid && step.phase != PLACE_CANDIDATES {
            let positions = step.model.get("candidates.positions");
            add_rigidity(step, &self.network, positions, self.nodes.rigid_neighbors, self.settings.rigidity);
        }
        Ok(())
    }

    /// Density control of the candidates in the phases before [`SETTLE_NODES`], from the first interval on.
    pub(crate) fn hooks(&self, phase: &str) -> Vec<Box<dyn StepHook>> {
        if phase == SETTLE_NODES {
            return Vec::new();
        }
        let density = Density { from: 0, max_count: self.settings.max_candidates, ..self.shared.density.clone() };
        let scale = self.shared.schedule_scale;
        let before = stretch(self.steps_before(phase), scale);
        let control = AdaptiveDensity::new(CANDIDATES, &density, scale, false).of_one_size();
        vec![Box::new(control.after(before))]
    }
}
