//! MoDec-GS (Kwak et al. 2025): anchors that move from segment to segment of time, and Gaussians that move within them.

#[cfg(test)]
mod tests;

use rand_chacha::ChaCha8Rng;
use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{columns, scale_rows};
use shaders::pointwise::{add, sigmoid};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::MethodFolder;
use crate::bases::anchors::{
    self, AnchorChange, AnchorDeformation, AnchorGrowth, AnchorSettings, Anchors, DeformationSettings, FINE,
    GaussianDeformation, SpawnedGaussians,
};
use crate::bases::gates::straight_through;
use crate::effects::{Effect, Need};
use crate::method::{Method, Moment, Phase, PopulationControl, SceneFacts, Start};
use crate::params::Shared;
use crate::schedule::LogLinear;
use crate::state::{ModelState, Variables};
use crate::step::Step;

/// The only effect.
const MOTION: &str = "motion";
/// [N, 2] before the logistic function: how much an anchor takes part in the motion of positions, and of all else.
const GATES: &str = "anchors.gates";
/// An anchor stands still where its first gate is not above this (published code).
const GATE_THRESHOLD: f64 = 0.01;

/// The folder's entry.
pub struct Modecgs;

/// What only this method understands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Anchors and their networks.
    pub anchors: AnchorSettings,
    /// The fields that move anchors and Gaussians.
    pub deformation: DeformationSettings,
    /// Equal parts of time; anchors stand still within each.
    pub segments: u32,
    /// Step size of the gates.
    pub gate_rate: LogLinear,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            anchors: AnchorSettings::default(),
            deformation: DeformationSettings::default(),
            segments: 8,
            gate_rate: LogLinear { start: 2e-3, end: 2e-5, steps: 30_000 },
        }
    }
}

impl MethodFolder for Modecgs {
    const NAME: &'static str = "modecgs";
    const ABOUT: &'static str = "MoDec-GS: anchors move globally, their Gaussians locally (Kwak et al. 2025)";
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        anchors::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        let about = "anchors move from segment to segment of time, their Gaussians within them";
        vec![Effect { name: MOTION, about, needs: &[Need::Times(2), Need::Motion], by_default: true }]
    }

    fn check(settings: &Settings) -> Result<(), String> {
        settings.anchors.check()?;
        settings.deformation.check()?;
        let good = [
            (settings.segments > 0, "segments must be at least 1"),
            (settings.gate_rate.is_valid(), "gate_rate must be positive"),
        ];
        good.iter().find(|(good, _)| !good).map_or(Ok(()), |(_, message)| Err(message.to_string()))
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings { anchors: AnchorSettings::tiny(), deformation: DeformationSettings::tiny(), ..Settings::default() }
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        Box::new(MotionDecomposition::new(shared, settings))
    }
}

struct MotionDecomposition {
    shared: Shared,
    settings: Settings,
    global: AnchorDeformation,
    local: GaussianDeformation,
}

impl MotionDecomposition {
    fn new(shared: &Shared, settings: Settings) -> Self {
        let global = AnchorDeformation::new(&settings.deformation, &settings.anchors);
        let local = GaussianDeformation::new(&settings.deformation);
        Self { shared: shared.clone(), settings, global, local }
    }

    /// Whether things move in a phase.
    fn moves(&self, phase: &str) -> bool {
        phase == FINE && self.shared.effects.has(MOTION)
    }

    /// The Gaussians of a view at a moment.
    fn gaussians<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> SpawnedGaussians {
        let canonical = Anchors::stored(model);
        if !self.moves(moment.phase) {
            return anchors::spawn(tape, model, &canonical, moment.camera);
        }
        let change = self.global.at(tape, model, canonical.positions, self.segment_time(moment.time));
        let moved = through_gates(tape, model.get(GATES), &canonical, &change);
        let mut spawned = anchors::spawn(tape, model, &moved, moment.camera);
        spawned.splats = self.local.deform(tape, model, spawned.splats, moment.time);
        spawned
    }

    /// The middle of the segment of a time in [0, 1].
    fn segment_time(&self, time: f64) -> f64 {
        let segments = f64::from(self.settings.segments);
        ((time * segments).floor().clamp(0.0, segments - 1.0) + 0.5) / segments
    }
}

/// Anchors plus their change: that of positions where the first gate is open, all else in proportion to the second.
fn through_gates<T: Real>(tape: &mut Tape<T>, gates: Var, canonical: &Anchors, change: &AnchorChange) -> Anchors {
    let gates = sigmoid(tape, gates);
    let (position_gate, soft) = (columns(tape, gates, 0..1), columns(tape, gates, 1..2));
    let open = straight_through(tape, position_gate, GATE_THRESHOLD);
    let mut gated = |attribute: Var, change: Var, gate: Var| {
        let change = scale_rows(tape, change, gate);
        add(tape, attribute, change)
    };
    Anchors {
        positions: gated(canonical.positions, change.positions, open),
        features: gated(canonical.features, change.features, soft),
        offsets: gated(canonical.offsets, change.offsets, soft),
        log_scales: gated(canonical.log_scales, change.log_scales, soft),
    }
}

impl<T: Real> Method<T> for MotionDecomposition {
    fn phases(&self) -> Vec<Phase> {
        anchors::phases(&self.shared)
    }

    fn initialize(
        &self,
        start: &Start<'_>,
        points: &PointCloud,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        let voxels = anchors::voxels(&points.positions, self.settings.anchors.voxel_size);
        let positions = voxels.into_iter().map(|(center, _)| center).collect();
        anchors::insert_anchors(&mut state, positions, &self.settings.anchors, start.scene().extent)?;
        anchors::insert_view_networks(&mut state, &self.settings.anchors, random);
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        _start: &Start<'_>,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        if self.moves(phase) {
            self.global.insert(&mut state, random)?;
            self.local.insert(&mut state, random)?;
            let count = state.get("anchors.positions")?.rows();
            state.insert(GATES, Tensor::zeros([count, 2]));
        }
        Ok(state)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if tensor == GATES {
            return Some(self.settings.gate_rate);
        }
        let anchors = self.settings.anchors.learning_rate(tensor, scene);
        anchors.or_else(|| self.settings.deformation.learning_rate(tensor, scene))
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.gaussians(tape, model, moment).splats)
    }

    fn rows(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(self.gaussians(tape, model, moment).slots.map(|slots| slots.to_vec()))
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let spawned = self.gaussians(step.tape, step.model, &moment);
            let rendered = step.render_rows(&spawned.splats, view, spawned.rows())?;
            anchors::photometric(step, rendered.color, view, None);
        }
        if self.moves(step.phase) {
            self.global.regularize(step);
            self.local.regularize(step);
        }
        Ok(())
    }

    fn population_controls(&self, _phase: &str, _scene: &SceneFacts) -> Vec<Box<dyn PopulationControl>> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        vec![Box::new(AnchorGrowth::new(density, &self.settings.anchors, *schedule_scale))]
    }
}
