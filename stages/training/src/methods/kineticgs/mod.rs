//! KineticGS: particles that are initialised from motion, move within activation windows, follow the optical flow and
//! stay coherent with their neighbours.

mod activation;
mod coherence;
mod energy_flow;
mod losses;
mod neighbors;
mod particles;
mod population;
mod settings;
#[cfg(test)]
mod tests;
mod weights;

use std::collections::BTreeMap;

use anyhow::Context as _;
use scene::cloud::PointCloud;
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::{scale, shift};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Tensor};

use super::MethodFolder;
use crate::bases::anchors::{
    self, AnchorDeformation, AnchoredGaussians, Anchors, FINE, GaussianDeformation, SpawnedGaussians,
};
use crate::bases::hexplane::field::{SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE};
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Moment, SILHOUETTE, Start, Step};
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;
use crate::shared::Shared;
use particles::{Moved, ParticleMotion, Particles};
use population::{DYNAMIC, LatestPopulation};
use settings::Settings;

const MOTION: &str = "motion";
const MOMENTUM_INIT: &str = "momentum-init";
const ACTIVATION: &str = "activation";
const ENERGY_FLOW: &str = "energy-flow";
const COHERENCE: &str = "coherence";

/// KineticGS: particles from momentum with activation windows, on anchors.
pub(crate) struct Kineticgs;

impl MethodFolder for Kineticgs {
    const NAME: &'static str = "kineticgs";
    // Anchors spawn the Gaussians.
    const GROWS_GAUSSIANS: bool = false;
    const KERNELS: &'static [&'static str] = &["losses/histogram"];
    const LOSSES: &'static [Loss] = &[
        SPATIAL_SMOOTHNESS,
        TEMPORAL_SMOOTHNESS,
        TIME_TO_ONE,
        SILHOUETTE,
        Loss::of("activation", "activation"),
        Loss::of("energy-flow", "energy_flow"),
        Loss::of("coherence", "coherence"),
    ];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        anchors::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        vec![
            Effect::new(MOTION, "particles and the Gaussians of all anchors move", &[Need::Times(2), Need::Motion]),
            SEED_FROM_MASKS,
            Effect::new(
                MOMENTUM_INIT,
                "particles start in moving regions; other anchors are static",
                &[Need::Particles, Need::Effect(MOTION)],
            ),
            Effect::new(
                ACTIVATION,
                "every particle moves within a window of time",
                &[Need::Times(4), Need::Effect(MOTION)],
            ),
            Effect::new(
                ENERGY_FLOW,
                "particles follow the optical flow",
                &[Need::Flow, Need::Depth, Need::Effect(MOTION)],
            ),
            Effect::new(COHERENCE, "neighbours move alike and at the same time", &[Need::Effect(MOTION)]),
            anchors::VIEW_DIRECTION,
        ]
    }

    fn idle_loss(settings: &Settings, time_count: usize) -> Option<(Loss, String)> {
        settings.deformation.idle_loss(time_count)
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings::tiny()
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        Box::new(KineticGaussians::new(shared, settings))
    }
}

struct KineticGaussians<T: Real> {
    base: AnchoredGaussians,
    shared: Shared,
    settings: Settings,
    motion: ParticleMotion,
    local: GaussianDeformation,
    population: LatestPopulation<T>,
}

impl<T: Real> KineticGaussians<T> {
    fn new(shared: &Shared, settings: Settings) -> Self {
        let motion = ParticleMotion {
            deformation: AnchorDeformation::new(&settings.deformation, &settings.anchors),
            gate_threshold: settings.gate_threshold,
            soft_location: settings.soft_location,
        };
        let local = GaussianDeformation::new(&settings.deformation);
        let population = LatestPopulation::default();
        let base = AnchoredGaussians::new(shared, &settings.anchors);
        Self { base, shared: shared.clone(), settings, motion, local, population }
    }

    /// Whether an effect is on; without motion, all are off.
    fn has(&self, effect: &str) -> bool {
        self.shared.effects.has(MOTION) && self.shared.effects.has(effect)
    }

    /// Whether particles move in a phase.
    fn moves(&self, phase: &str) -> bool {
        phase == FINE && self.has(MOTION)
    }

    fn particles<'s>(&self, tape: &mut Tape<T>, model: &Variables, scene: &'s SceneFacts) -> Particles<'s, T> {
        let population = self.population.of(tape, model);
        self.motion.particles(tape, model, population, self.has(ACTIVATION), scene)
    }

    /// The Gaussians of a view at a moment.
    fn spawned(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> SpawnedGaussians {
        if !self.moves(moment.phase) {
            return self.static_gaussians(tape, model, moment.camera);
        }
        let particles = self.particles(tape, model, moment.scene);
        let moved = self.motion.at(tape, model, &particles, moment.time);
        self.gaussians(tape, model, &moved, moment)
    }

    /// The Gaussians of the static anchors. Particles are neither rendered nor trained before they can move: a static
    /// particle is wrong at all instants but its first, so it would become transparent and be pruned.
    fn static_gaussians(&self, tape: &mut Tape<T>, model: &Variables, camera: &PinholeCamera) -> SpawnedGaussians {
        let particles = model.find(DYNAMIC).filter(|_| !self.settings.coarse_all);
        let is_static = particles.map(|flags| {
            let negated = scale(tape, flags, -1.0);
            shift(tape, negated, 1.0)
        });
        anchors::spawn(tape, model, &Anchors::stored(model), is_static, camera)
    }

    /// The Gaussians of moved anchors at a moment.
    fn gaussians(&self, tape: &mut Tape<T>, model: &Variables, moved: &Moved, moment: &Moment<'_>) -> SpawnedGaussians {
        let spawned = anchors::spawn(tape, model, &moved.anchors, None, moment.camera);
        self.local.all_at(tape, model, moment, spawned)
    }
}

impl<T: Real> Method<T> for KineticGaussians<T> {
    fn base(&self) -> &dyn Base<T> {
        &self.base
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        let mut positions = self.base.positions(points, start.scene());
        if self.has(MOMENTUM_INIT) {
            let seeds = start.supplements.particles.as_ref();
            let seeds = &seeds.context("momentum-init is on, but no particles were given")?.positions;
            // One particle per voxel, at the position of its first seed.
            let size = self.settings.anchors.voxel_size * start.scene().unit_world;
            let particles = anchors::voxels(seeds, size).into_iter().map(|(_, first)| seeds[first]);
            let static_count = positions.len();
            positions.extend(particles);
            let flag = |row: usize| if row < static_count { T::ZERO } else { T::ONE };
            let flags = (0..positions.len()).map(flag).collect();
            state.insert(DYNAMIC, Tensor::from_vec([positions.len(), 1], flags));
        }
        self.base.insert(&mut state, positions, start.scene(), random);
        if self.has(MOTION) {
            anchors::insert_boxes(&mut state)?;
        }
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if self.moves(phase) {
            self.motion.deformation.insert(&mut state, start.scene(), random);
            self.local.insert(&mut state, start.scene(), random);
            if self.has(ACTIVATION) {
                activation::insert(&mut state, random);
            }
            self.base.insert_subject(&mut state, start)?;
        }
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if belongs(tensor, activation::ACTIVATION) {
            return Some(self.settings.activation_rate);
        }
        let of_anchors = Method::<T>::base(self).learning_rate(phase, tensor, scene);
        of_anchors.or_else(|| self.settings.deformation.learning_rate(tensor, scene))
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.spawned(tape, model, moment).splats)
    }

    fn rows(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(self.spawned(tape, model, moment).rows_at_moment())
    }

    fn figures(&self, tape: &mut Tape<T>, model: &Variables, scene: &SceneFacts) -> BTreeMap<String, f64> {
        if !self.has(MOTION) {
            return BTreeMap::new();
        }
        let particles = self.particles(tape, model, scene);
        let rows = &particles.population.rows;
        let share = 100.0 * rows.len() as f64 / rows.rows().max(1) as f64;
        let windows = particles.windows.map(|windows| windows.figures(tape));
        let shares = [("particles among the anchors (%)".to_string(), share)];
        shares.into_iter().chain(windows.unwrap_or_default()).collect()
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if self.moves(step.phase) { self.fine_losses(step) } else { self.coarse_losses(step) }
    }
}
