//! MCGS: control nodes with motion that a coordinate network and a Markov chain over previous states predict together.

mod controls;
mod markov;
mod motion;
mod node_motion;
mod noise;
mod physics;
mod prediction;
mod settings;
#[cfg(test)]
mod tests;
mod training_motion;
mod visibility;

use std::collections::BTreeMap;

use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::canonical::{ALL, CanonicalGaussians, WARM_UP};
use crate::bases::control_nodes::{NODE_PHASES, NodeStage, farthest_points, insert_nodes, rows_of, sides};
use crate::bases::gaussians::{self, GAUSSIANS, logit};
use crate::bases::static_mask::{self, MAY_MOVE, SKIP_STILL};
use crate::bases::time_noise::{TIME_NOISE, TimeNoise};
use crate::data::{SceneFacts, Streams, TrainingView};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Moment, Observed, SILHOUETTE, Start, Step, StepHook, photometric_losses};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::Shared;
use controls::{Ramp, VISIBILITY_INTERVAL, Visibility};
use motion::Nodes;
use scene::cloud::PointCloud;
use settings::{NodeSource, Settings};

/// [2]: the mixing shares λ_pos and λ_rot.
const SHARES: &str = "mixing.shares";
/// [1]: the remaining noise level, from 1 down to 0.
const NOISE: &str = "mixing.noise";
/// [M, 1]: running mean of the visible share of the weight of a node's Gaussians; initially 1. Also the name under
/// which a step passes the measured weights to the hooks.
const VISIBILITY: &str = "nodes.visibility";

/// Gaussians below this opacity do not become nodes, because they mark no surface.
const MIN_NODE_OPACITY: f64 = 0.1;
/// Name of the reported [`Nodes::chain_error`], which shows whether the chain contributes to the motion.
const CHAIN_ERROR: &str = "error of the chain's steps (1: no better than no step)";
/// Why `rigidity` is kept where it is inert.
const WEIGHT_OF_SCGS: &str = "equation 16 of the paper, with the weight of SC-GS";
/// Why `attention` is on where it is inert.
const WINDOW: &str = "equations 14 and 15 of the paper; it costs a third of the time, gains up to 0.15 dB on some scenes, and \
                      `effects = [\"-attention\"]` switches it off";
/// Why `noise` is on where it is inert.
const SMALL: &str = "equations 6 and 7 of the paper; it acts only if the noise reaches about a pixel of the image \
                     (`mcgs.noise.position_px`), and `effects = [\"-noise\"]` switches it off";
/// Why `physics` is on where it is inert.
const VELOCITIES: &str = "equations 17 to 19 of the paper; it lowers the velocity error of some scenes, not PSNR, and \
                          `effects = [\"-physics\"]` switches it off";

/// MCGS: control nodes with motion that follows a Markov chain.
pub(crate) struct Mcgs;

impl MethodFolder for Mcgs {
    const NAME: &'static str = "mcgs";
    const KERNELS: &'static [&'static str] = &["networks/layer_norm"];
    const LOSSES: &'static [Loss] = &[
        Loss::of("arap", "rigidity").stays(WEIGHT_OF_SCGS),
        Loss::of("physics", "acceleration"),
        Loss::of("physics", "speed_penalty"),
        Loss::of("motion", "prediction"),
        SILHOUETTE,
    ];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        let iterations = NODE_PHASES.into_iter().chain([(WARM_UP, 3000), (ALL, 27_000)]);
        let iterations = iterations.map(|(phase, count)| (phase.into(), count)).collect();
        Shared { iterations, ..Shared::default() }
    }

    fn effects() -> Vec<Effect> {
        const OF_MOTION: &[Need] = &[Need::Effect("motion")];
        vec![
            Effect::new(
                "motion",
                "control nodes carry the Gaussians; a coordinate network and a Markov chain move them",
                &[Need::Times(2), Need::Motion],
            ),
            SKIP_STILL,
            SEED_FROM_MASKS,
            Effect::new("attention", "the chain attends over a window of states, not only the last one", OF_MOTION)
                .stays(WINDOW),
            Effect::new("noise", "annealed noise on predicted motion, stronger for rarely visible nodes", OF_MOTION)
                .stays(SMALL),
            Effect::new("arap", "neighbouring nodes move as rigidly as possible", OF_MOTION),
            Effect::new(
                "physics",
                "penalties on the acceleration and the speed of nodes",
                &[Need::Times(3), Need::Effect("motion")],
            )
            .stays(VELOCITIES),
            TIME_NOISE,
        ]
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings::tiny()
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        let moves = shared.effects.has("motion");
        let on = |name: &str| moves && shared.effects.has(name);
        let nodes = Nodes::new(&settings, on("attention"));
        let stage = NodeStage::new(shared, &settings.node_stage, &settings.nodes, nodes.network(), on("arap"));
        let time_noise = on(TIME_NOISE.name).then(|| TimeNoise::new(settings.time_noise, settings.time_noise_until));
        Box::new(MarkovGaussians {
            canonical: CanonicalGaussians::new(shared),
            stage: (moves && settings.nodes_from == NodeSource::Candidates).then(|| stage.with_noise(time_noise)),
            nodes,
            moves,
            time_noise,
            has_noise: on("noise"),
            is_rigid: on("arap"),
            has_physics: on("physics"),
            shared: shared.clone(),
            settings,
        })
    }
}

struct MarkovGaussians {
    shared: Shared,
    settings: Settings,
    canonical: CanonicalGaussians,
    /// The stage before the warm-up, if nodes are chosen from candidates.
    stage: Option<NodeStage>,
    nodes: Nodes,
    moves: bool,
    time_noise: Option<TimeNoise>,
    has_noise: bool,
    is_rigid: bool,
    has_physics: bool,
}

impl<T: Real> Method<T> for MarkovGaussians {
    fn base(&self) -> &dyn Base<T> {
        &self.canonical
    }

    fn phases(&self) -> Vec<Phase> {
        let of_nodes = NodeStage::phases(&self.shared, self.stage.is_some());
        [of_nodes, vec![self.canonical.phase(WARM_UP), self.canonical.phase(ALL)]].concat()
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        let Some(stage) = &self.stage else { return self.canonical.initialize(start, points, random) };
        let mut state = ModelState::new();
        stage.insert_candidates(&mut state, start.scene(), points);
        self.nodes.network().insert(&mut state, points, random);
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if let Some(stage) = &self.stage {
            state = stage.enter_phase(phase, WARM_UP, state, start.scene())?;
            if phase == WARM_UP {
                let points = start.initial_points(&self.shared)?;
                gaussians::insert_initial(&mut state, &self.shared, start.scene(), &points);
            }
        }
        if self.moves && phase == ALL {
            // Before nodes are chosen among the Gaussians, so that there are nodes on the subject.
            static_mask::insert(&mut state, &self.shared, start)?;
            if self.stage.is_none() {
                self.choose_nodes(&mut state, start.scene())?;
                self.nodes.network().insert(&mut state, &start.initial_points(&self.shared)?, random);
            }
            self.nodes.insert_chain(&mut state, random);
            controls::insert(&mut state, &self.settings, self.has_noise)?;
        }
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if let Some(stage) = self.stage.as_ref().filter(|_| NodeStage::has(phase)) {
            return stage.learning_rate(phase, tensor, scene);
        }
        let of_nodes = || {
            let law = self.nodes.learning_rate(tensor, scene).filter(|_| phase == ALL)?;
            Some(law.after(self.canonical.iterations(WARM_UP)))
        };
        Method::<T>::base(self).learning_rate(phase, tensor, scene).or_else(of_nodes)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        if let Some(stage) = self.stage.as_ref().filter(|_| NodeStage::has(moment.phase)) {
            return Ok(stage.splats(tape, model, moment));
        }
        let canonical = self.canonical.splats(tape, model, moment)?;
        if !self.moves || moment.phase != ALL {
            // Gaussians that restart among trained nodes follow them from the start.
            let motion = self.stage.as_ref().map(|_| self.nodes.direct(tape, model, &[moment.time]));
            return Ok(motion.map_or(canonical, |motion| self.nodes.carry(tape, model, moment, canonical, &motion)));
        }
        let predictions = self.nodes.predict(tape, model, &[moment.time], moment.scene);
        let motion = self.nodes.mix(tape, model, &predictions);
        Ok(self.nodes.carry(tape, model, moment, canonical, &motion))
    }

    fn figures(&self, tape: &mut Tape<T>, model: &Variables, scene: &SceneFacts) -> BTreeMap<String, f64> {
        let error = self.moves.then(|| self.nodes.chain_error(tape, model, scene)).flatten();
        error.map(|error| (CHAIN_ERROR.to_owned(), error)).into_iter().collect()
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if let Some(stage) = self.stage.as_ref().filter(|_| NodeStage::has(step.phase)) {
            return stage.losses(step);
        }
        if !self.moves || step.phase != ALL {
            return photometric_losses(self, step);
        }
        static_mask::count_skipped(step);
        let measures_visibility =
            self.has_noise && step.iteration.is_multiple_of(VISIBILITY_INTERVAL) && noise::left(step) > 0.0;
        for view in step.views {
            step.clock.enter("motion");
            let canonical = gaussians::static_splats(step.tape, step.model, GAUSSIANS, step.sh_degree);
            let time = self.training_time(step, view);
            let motion = self.training_motion(step, time, &view.camera);
            let moment = Moment { time, ..step.moment(view) };
            let splats = self.nodes.carry(step.tape, step.model, &moment, canonical, &motion);
            if measures_visibility {
                visibility::measure(step, &splats, view)?;
            }
            step.compare(&splats, view, Observed::All(GAUSSIANS))?;
        }
        Ok(())
    }

    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        if let Some(stage) = self.stage.as_ref().filter(|_| NodeStage::has(phase)) {
            return stage.hooks(phase);
        }
        let mut hooks: Vec<Box<dyn StepHook>> = Vec::new();
        if self.moves && phase == ALL {
            let scale = self.shared.schedule_scale;
            let before = self.canonical.iterations(WARM_UP);
            let ramp = Ramp::new(&self.settings, before, scale);
            let visibility = self.has_noise.then(|| Visibility::new(self.settings.nodes.per_gaussian, &ramp));
            hooks.push(Box::new(ramp));
            hooks.extend(visibility.map(|hook| Box::new(hook) as Box<dyn StepHook>));
        }
        // Density control runs last: it changes the number of Gaussians that the other hooks have observed.
        hooks.extend(Method::<T>::base(self).hooks(phase, scene));
        hooks
    }
}

impl MarkovGaussians {
    /// Places the nodes on Gaussians that are far apart and may move.
    fn choose_nodes<T: Real>(&self, state: &mut ModelState<T>, scene: &SceneFacts) -> anyhow::Result<()> {
        let positions = state.get("gaussians.positions")?;
        let opacities = state.get("gaussians.opacity_logits")?.as_slice();
        let faintest = T::from_f64(logit(MIN_NODE_OPACITY));
        let flags = state.get(MAY_MOVE).ok().map(|flags| flags.as_slice());
        let movable: Vec<usize> =
            (0..opacities.len()).filter(|&at| flags.is_none_or(|flags| flags[at] > T::ZERO)).collect();
        let mut solid: Vec<usize> = movable.iter().copied().filter(|&at| opacities[at] >= faintest).collect();
        if solid.len() < self.settings.nodes.count {
            solid = if movable.is_empty() { (0..opacities.len()).collect() } else { movable };
        }
        let solid = rows_of(positions, &solid);
        let chosen = rows_of(&solid, &farthest_points(&solid, self.settings.nodes.count));
        let diagonal = sides(&chosen).iter().map(|side| side * side).sum::<f64>().sqrt();
        insert_nodes(state, chosen, self.settings.nodes.first_radius * diagonal, scene);
        Ok(())
    }

    /// The time of a training view, with noise if the effect is on.
    fn training_time<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>) -> f64 {
        let noisy = self.time_noise.map(|noise| noise.time(step, view, self.canonical.iterations(WARM_UP)));
        noisy.unwrap_or(view.time)
    }
}
