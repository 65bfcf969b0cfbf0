//! SC-GS (Huang et al. 2024): a few hundred control nodes, moved by a coordinate network, move all Gaussians.

mod nodes;
#[cfg(test)]
mod tests;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::canonical::{ALL, CanonicalGaussians, WARM_UP};
use crate::bases::control_nodes::{
    ControlNodeSettings, NODE_PHASES, NodeStage, NodeStageSettings, add_rigidity, rigidity_left,
};
use crate::bases::coordinate_mlp::CoordinateMlpSettings;
use crate::bases::gaussians::{self, GAUSSIANS};
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::bases::time_noise::{FIRST_TIME_NOISE, TIME_NOISE, TIME_NOISE_UNTIL, TimeNoise};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Moment, Observed, SILHOUETTE, Start, Step, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::{Density, Shared};
use nodes::Nodes;

/// Maximum learnt coordinates of a Gaussian, far beyond any use: a larger value is a typing error.
const MAX_FEATURES: usize = 64;

/// SC-GS: sparse control nodes carry canonical Gaussians (Huang et al. 2024).
pub(crate) struct Scgs;

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// The network that moves the nodes.
    pub network: CoordinateMlpSettings,
    /// The control nodes.
    pub nodes: ControlNodeSettings,
    /// Number of learnt coordinates that extend the three spatial ones in the node search of the Gaussians.
    pub features: usize,
    /// Learning rate of the Gaussians' learnt coordinates.
    pub feature_rate: f64,
    /// Number of initial candidates, points that lie far apart.
    pub candidates: usize,
    /// Maximum number of candidates.
    pub max_candidates: usize,
    /// Initial weight of the effect `arap`.
    pub rigidity: f64,
    /// Weight of the effect `arap` on candidates.
    pub candidate_rigidity: f64,
    /// Initial standard deviation of the effect `time-noise`, in frame intervals.
    pub time_noise: f64,
    /// Iteration at which the time noise reaches zero, in the node stage and after it.
    pub time_noise_until: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            network: CoordinateMlpSettings::default(),
            nodes: ControlNodeSettings { rate: LogLinear::constant(8e-4), ..ControlNodeSettings::default() },
            features: 8,
            feature_rate: 2.5e-3,
            candidates: 512,
            max_candidates: 8192,
            rigidity: 1e-4,
            candidate_rigidity: 1e-2,
            time_noise: FIRST_TIME_NOISE,
            time_noise_until: TIME_NOISE_UNTIL,
        }
    }
}

impl Settings {
    fn node_stage(&self) -> NodeStageSettings {
        let Self { candidates, max_candidates, candidate_rigidity: rigidity, .. } = *self;
        NodeStageSettings { candidates, max_candidates, rigidity }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("network", &self.network)
            .table("nodes", &self.nodes)
            .at_most(MAX_FEATURES, fields!(self, features))
            .rates(fields!(self, feature_rate))
            .at_least_one(fields!(self, candidates))
            .require("max_candidates", self.max_candidates >= self.candidates, "must be at least candidates")
            .not_negative(fields!(self, rigidity, candidate_rigidity, time_noise))
    }
}

impl MethodFolder for Scgs {
    const NAME: &'static str = "scgs";
    const LOSSES: &'static [Loss] = &[Loss::of("arap", "rigidity"), SILHOUETTE];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        let iterations = NODE_PHASES.into_iter().chain([(WARM_UP, 3000), (ALL, 67_000)]);
        Shared {
            iterations: iterations.map(|(phase, count)| (phase.into(), count)).collect(),
            density: Density { until: 50_000, ..Density::default() },
            ..Shared::default()
        }
    }

    fn effects() -> Vec<Effect> {
        vec![
            Effect::new("motion", "control nodes carry the Gaussians", &[Need::Times(2), Need::Motion]),
            SKIP_STILL,
            SEED_FROM_MASKS,
            Effect::new("arap", "neighbouring nodes move as rigidly as possible", &[Need::Effect("motion")]),
            TIME_NOISE,
        ]
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings {
            network: CoordinateMlpSettings::tiny(),
            nodes: ControlNodeSettings { rate: LogLinear::constant(8e-4), ..ControlNodeSettings::tiny() },
            features: 2,
            rigidity: 0.1,
            candidate_rigidity: 0.1,
            ..Settings::default()
        }
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        let moves = shared.effects.has("motion");
        let is_rigid = moves && shared.effects.has("arap");
        let time_noise = (moves && shared.effects.has(TIME_NOISE.name))
            .then(|| TimeNoise::new(settings.time_noise, settings.time_noise_until));
        let nodes = Nodes::new(&settings);
        let stage = NodeStage::new(shared, &settings.node_stage(), &settings.nodes, nodes.network(), is_rigid)
            .with_noise(time_noise);
        Box::new(SparselyControlled {
            canonical: CanonicalGaussians::new(shared),
            stage,
            nodes,
            time_noise,
            moves,
            is_rigid,
            shared: shared.clone(),
            settings,
        })
    }
}

struct SparselyControlled {
    shared: Shared,
    settings: Settings,
    canonical: CanonicalGaussians,
    stage: NodeStage,
    nodes: Nodes,
    time_noise: Option<TimeNoise>,
    moves: bool,
    is_rigid: bool,
}

impl<T: Real> Method<T> for SparselyControlled {
    fn base(&self) -> &dyn Base<T> {
        &self.canonical
    }

    fn phases(&self) -> Vec<Phase> {
        let of_nodes = NodeStage::phases(&self.shared, self.moves);
        [of_nodes, vec![self.canonical.phase(WARM_UP), self.canonical.phase(ALL)]].concat()
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        if !self.moves {
            return self.canonical.initialize(start, points, random);
        }
        let mut state = ModelState::new();
        self.stage.insert_candidates(&mut state, start.scene(), points);
        self.nodes.network().insert(&mut state, points, random);
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        state: ModelState<T>,
        start: &Start<'_>,
        _random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if !self.moves {
            return Ok(state);
        }
        let mut state = self.stage.enter_phase(phase, WARM_UP, state, start.scene())?;
        if phase != WARM_UP {
            return Ok(state);
        }
        self.nodes.insert_gates_and_features(&mut state)?;
        // The Gaussians restart from the initial points, like the candidates.
        let points = start.initial_points(&self.shared)?;
        gaussians::insert_initial(&mut state, &self.shared, start.scene(), &points);
        static_mask::insert(&mut state, &self.shared, start)?;
        self.nodes.insert_gaussian_features(&mut state)?;
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if self.has_candidates(phase) {
            return self.stage.learning_rate(phase, tensor, scene);
        }
        let of_gaussians = Method::<T>::base(self).learning_rate(phase, tensor, scene);
        // The schedule of the network restarts with the Gaussians, which learn alone first.
        let of_nodes = || self.nodes.learning_rate(tensor, self.canonical.iterations(WARM_UP)).filter(|_| phase == ALL);
        of_gaussians.or_else(of_nodes)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        if !self.moves {
            return self.canonical.splats(tape, model, moment);
        }
        if self.has_candidates(moment.phase) {
            return Ok(self.stage.splats(tape, model, moment));
        }
        let canonical = self.canonical.splats(tape, model, moment)?;
        Ok(static_mask::move_some(tape, model, moment, canonical, |tape, some, rows| {
            self.nodes.carry(tape, model, some, rows, moment)
        }))
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if self.has_candidates(step.phase) {
            return self.stage.losses(step);
        }
        static_mask::count_skipped(step);
        for view in step.views {
            step.clock.enter("motion");
            let before = if step.phase == ALL { self.canonical.iterations(WARM_UP) } else { 0 };
            let noisy = self.time_noise.map(|noise| noise.time(step, view, before));
            let moment = Moment { time: noisy.unwrap_or(view.time), ..step.moment(view) };
            let splats = self.splats(step.tape, step.model, &moment)?;
            step.compare(&splats, view, Observed::All(GAUSSIANS))?;
        }
        if self.is_rigid && step.phase == ALL {
            let weight = self.settings.rigidity * rigidity_left(&self.shared, step.iteration);
            let positions = step.model.get("nodes.positions");
            add_rigidity(step, self.nodes.network(), positions, self.settings.nodes.rigid_neighbors, weight);
        }
        Ok(())
    }

    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        match NodeStage::has(phase) {
            true if self.moves => self.stage.hooks(phase),
            true => Vec::new(),
            false => Method::<T>::base(self).hooks(phase, scene),
        }
    }
}

impl SparselyControlled {
    /// Whether the model of a phase consists of node candidates.
    fn has_candidates(&self, phase: &str) -> bool {
        self.moves && NodeStage::has(phase)
    }
}
