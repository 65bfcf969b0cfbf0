//! SC-GS (Huang et al. 2024): a few hundred control nodes, moved by a coordinate network, carry all Gaussians.

mod candidates;
mod nodes;
#[cfg(test)]
mod tests;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::canonical::{ALL, CanonicalGaussians, WARM_UP};
use crate::bases::control_nodes::{ControlNodeSettings, published_decay};
use crate::bases::coordinate_mlp::CoordinateMlpSettings;
use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss, Need};
use crate::method::{Base, Method, Moment, Observed, Start, Step, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase, stretch};
use crate::shared::{Density, Shared};
use nodes::Nodes;

/// The population of candidates.
const CANDIDATES: &str = "candidates";
/// The phase that places the node candidates, each rendered as a static Gaussian. If they moved from the first step on,
/// the network would learn to move all of them out of the image, because random points are worse than an empty
/// background.
const PLACE_CANDIDATES: &str = "place-candidates";
/// The phase in which candidates move.
const CHOOSE_NODES: &str = "choose-nodes";

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
    /// Number of points that become initial candidates, evenly chosen.
    pub candidates: usize,
    /// Maximum number of candidates.
    pub max_candidates: usize,
    /// Initial weight of the effect `arap`.
    pub rigidity: f64,
    /// Weight of the effect `arap` on candidates.
    pub candidate_rigidity: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            network: CoordinateMlpSettings::default(),
            nodes: ControlNodeSettings { rate: LogLinear::constant(8e-4), ..ControlNodeSettings::default() },
            features: 8,
            feature_rate: 2.5e-3,
            candidates: 2048,
            max_candidates: 8192,
            rigidity: 1e-4,
            candidate_rigidity: 1e-2,
        }
    }
}

impl MethodFolder for Scgs {
    const NAME: &'static str = "scgs";
    const LOSSES: &'static [Loss] = &[Loss::of("arap", "rigidity")];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        let iterations = [(PLACE_CANDIDATES, 2000), (CHOOSE_NODES, 5500), (WARM_UP, 3000), (ALL, 67_000)];
        Shared {
            iterations: iterations.map(|(phase, count)| (phase.into(), count)).into(),
            density: Density { until: 50_000, ..Density::default() },
            ..Shared::default()
        }
    }

    fn effects() -> Vec<Effect> {
        vec![
            Effect {
                name: "motion",
                about: "control nodes carry the Gaussians",
                needs: &[Need::Times(2), Need::Motion],
                by_default: true,
            },
            SKIP_STILL,
            Effect {
                name: "arap",
                about: "neighbouring nodes move as rigidly as possible",
                needs: &[Need::Effect("motion")],
                by_default: true,
            },
        ]
    }

    fn check(settings: &Settings) -> Result<(), String> {
        settings.network.check()?;
        settings.nodes.check()?;
        let weights = [settings.rigidity, settings.candidate_rigidity];
        let good = [
            (settings.features <= 64, "features must be 64 at most"),
            (settings.feature_rate > 0.0 && settings.feature_rate.is_finite(), "feature_rate must be positive"),
            (settings.candidates > 0, "candidates must be at least 1"),
            (settings.max_candidates >= settings.candidates, "max_candidates must not be less than candidates"),
            (weights.iter().all(|&weight| weight >= 0.0 && weight.is_finite()), "weights must not be negative"),
        ];
        good.iter().find(|(good, _)| !good).map_or(Ok(()), |(_, message)| Err(message.to_string()))
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
        Box::new(SparselyControlled {
            canonical: CanonicalGaussians::new(shared),
            nodes: Nodes::new(&settings),
            moves,
            is_rigid: moves && shared.effects.has("arap"),
            shared: shared.clone(),
            settings,
        })
    }
}

struct SparselyControlled {
    shared: Shared,
    settings: Settings,
    canonical: CanonicalGaussians,
    nodes: Nodes,
    moves: bool,
    is_rigid: bool,
}

impl<T: Real> Method<T> for SparselyControlled {
    fn base(&self) -> &dyn Base<T> {
        &self.canonical
    }

    fn phases(&self) -> Vec<Phase> {
        let of_candidates = |name| match self.moves {
            true => self.canonical.phase(name),
            false => Phase { name, iterations: 0 },
        };
        let [place, choose] = [PLACE_CANDIDATES, CHOOSE_NODES].map(of_candidates);
        vec![place, choose, self.canonical.phase(WARM_UP), self.canonical.phase(ALL)]
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        if !self.moves {
            return self.canonical.initialize(start, points, random);
        }
        let mut state = ModelState::new();
        let degree = self.shared.harmonics.degree;
        candidates::insert(&mut state, start.scene(), points, self.settings.candidates, degree)?;
        self.nodes.insert_network(&mut state, points, random);
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        state: ModelState<T>,
        start: &Start<'_>,
        _random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if !self.moves || phase != WARM_UP {
            return Ok(state);
        }
        let mut state = self.nodes.choose(state)?;
        // The Gaussians restart from the initial points, like the candidates.
        let points = start.initial_points(&self.shared)?;
        gaussians::insert_initial(&mut state, &self.shared, start.scene(), &points)?;
        self.nodes.insert_gaussian_features(&mut state)?;
        static_mask::insert(&mut state, &self.shared.effects, start)?;
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if self.has_candidates(phase) {
            let law = candidates::learning_rate(&self.shared.learning_rates, tensor, scene);
            let of_candidates = law.map(|law| law.after(self.steps_of_candidates_before(phase)));
            let of_network = || self.nodes.learning_rate_among_candidates(tensor).filter(|_| phase == CHOOSE_NODES);
            return of_candidates.or_else(of_network);
        }
        let of_gaussians = Method::<T>::base(self).learning_rate(phase, tensor, scene);
        of_gaussians.or_else(|| self.nodes.learning_rate(tensor, phase == ALL, self.steps_before_all()))
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        if !self.moves {
            return self.canonical.splats(tape, model, moment);
        }
        if self.has_candidates(moment.phase) {
            let nodes = (moment.phase == CHOOSE_NODES).then_some(&self.nodes);
            return Ok(candidates::splats(tape, model, nodes, moment));
        }
        let canonical = self.canonical.splats(tape, model, moment)?;
        Ok(static_mask::move_some(tape, model, canonical, |tape, some, rows| {
            self.nodes.carry(tape, model, some, rows, moment.time)
        }))
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        static_mask::count_skipped(step);
        let population = if self.has_candidates(step.phase) { CANDIDATES } else { GAUSSIANS };
        for view in step.views {
            step.clock.enter("motion");
            let splats = self.splats(step.tape, step.model, &step.moment(view))?;
            let rendered = step.render(&splats, None, view, Observed::All(population))?;
            step.photometric(rendered.color, view);
        }
        if self.is_rigid && [CHOOSE_NODES, ALL].contains(&step.phase) {
            let weight = match step.phase {
                CHOOSE_NODES => self.settings.candidate_rigidity,
                _ => self.rigidity_weight(step.iteration),
            };
            self.nodes.add_rigidity(step, population, weight);
        }
        Ok(())
    }

    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        if [PLACE_CANDIDATES, CHOOSE_NODES].contains(&phase) {
            let white = scene.background == [1.0; 3];
            let density = Density { max_count: self.settings.max_candidates, ..self.shared.density.clone() };
            let scale = self.shared.schedule_scale;
            let before = stretch(self.steps_of_candidates_before(phase), scale);
            let control = AdaptiveDensity::new(CANDIDATES, &density, scale, white).after(before);
            return if self.moves { vec![Box::new(control)] } else { Vec::new() };
        }
        Method::<T>::base(self).hooks(phase, scene)
    }
}

impl SparselyControlled {
    /// Whether the model of a phase consists of node candidates.
    fn has_candidates(&self, phase: &str) -> bool {
        self.moves && [PLACE_CANDIDATES, CHOOSE_NODES].contains(&phase)
    }

    /// Number of candidate steps before a phase, before stretching.
    fn steps_of_candidates_before(&self, phase: &str) -> u64 {
        if phase == CHOOSE_NODES { self.canonical.iterations(PLACE_CANDIDATES) } else { 0 }
    }

    /// Number of network steps before [`ALL`], before stretching.
    fn steps_before_all(&self) -> u64 {
        [PLACE_CANDIDATES, CHOOSE_NODES, WARM_UP].map(|phase| self.canonical.iterations(phase)).iter().sum()
    }

    /// The weight of rigidity in [`ALL`]; its schedule counts the steps of the Gaussians.
    fn rigidity_weight(&self, iteration: u64) -> f64 {
        let unstretched = iteration as f64 / self.shared.schedule_scale + self.canonical.iterations(WARM_UP) as f64;
        self.settings.rigidity * published_decay(unstretched)
    }
}
