//! MoDec-GS (Kwak et al. 2025): anchors that move from time segment to time segment, and Gaussians that move within
//! them.

#[cfg(test)]
mod tests;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{columns, scale_rows};
use shaders::pointwise::{add, sigmoid};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::MethodFolder;
use crate::bases::anchors::{
    self, AnchorChange, AnchorDeformation, AnchorSettings, AnchoredGaussians, Anchors, DeformationSettings, FINE,
    GaussianDeformation, SpawnedGaussians,
};
use crate::bases::gates::straight_through;
use crate::bases::hexplane::field::{SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Moment, SILHOUETTE, Start, Step};
use crate::model::{ModelState, Variables};
use crate::schedule::LogLinear;
use crate::shared::Shared;

/// The effect of both fields.
const MOTION: &str = "motion";
/// [N, 2] logits of each anchor's gates, for the motion of its position and for all other changes.
const GATES: &str = "anchors.gates";
/// An anchor is static while its first gate is at or below this value (published code).
const GATE_THRESHOLD: f64 = 0.01;

/// MoDec-GS: anchors move globally, their Gaussians locally (Kwak et al. 2025).
pub(crate) struct Modecgs;

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// Anchors and their networks.
    pub anchors: AnchorSettings,
    /// The deformation fields of anchors and Gaussians.
    pub deformation: DeformationSettings,
    /// Number of equal time segments; anchors are static within each.
    pub segments: u32,
    /// Learning rate of the gates.
    pub gate_rate: LogLinear,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            anchors: AnchorSettings::default(),
            deformation: DeformationSettings::default(),
            segments: 8,
            gate_rate: LogLinear::constant(2e-3),
        }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("anchors", &self.anchors)
            .table("deformation", &self.deformation)
            .at_least_one(fields!(self, segments))
            .table("gate_rate", &self.gate_rate)
    }
}

impl MethodFolder for Modecgs {
    const NAME: &'static str = "modecgs";
    // Anchors spawn the Gaussians.
    const GROWS_GAUSSIANS: bool = false;
    const LOSSES: &'static [Loss] = &[SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE, SILHOUETTE];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        anchors::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        let about = "anchors move between time segments, their Gaussians within them";
        let motion = Effect::new(MOTION, about, &[Need::Times(2), Need::Motion]);
        vec![motion, SEED_FROM_MASKS, anchors::VIEW_DIRECTION]
    }

    fn idle_loss(settings: &Settings, time_count: usize) -> Option<(Loss, String)> {
        settings.deformation.idle_loss(time_count)
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
    base: AnchoredGaussians,
    settings: Settings,
    global: AnchorDeformation,
    local: GaussianDeformation,
    has_motion: bool,
}

impl MotionDecomposition {
    fn new(shared: &Shared, settings: Settings) -> Self {
        let global = AnchorDeformation::new(&settings.deformation, &settings.anchors);
        let local = GaussianDeformation::new(&settings.deformation);
        let base = AnchoredGaussians::new(shared, &settings.anchors).with_zeros(&["offsets", "gates"]);
        let has_motion = shared.effects.has(MOTION);
        Self { base, settings, global, local, has_motion }
    }

    /// Whether anchors and Gaussians move in a phase.
    fn moves(&self, phase: &str) -> bool {
        phase == FINE && self.has_motion
    }

    /// The Gaussians of a view at a moment.
    fn gaussians<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> SpawnedGaussians {
        if !self.moves(moment.phase) {
            return self.base.spawn(tape, model, moment.camera);
        }
        let canonical = Anchors::stored(model);
        let segment_time = self.segment_time(moment.time);
        let change = self.global.at(tape, model, moment.scene, canonical.positions, segment_time);
        let moved = through_gates(tape, model.get(GATES), &canonical, &change);
        let spawned = anchors::spawn(tape, model, &moved, None, moment.camera);
        self.local.all_at(tape, model, moment, spawned)
    }

    /// The start of the segment that contains a time in [0, 1].
    fn segment_time(&self, time: f64) -> f64 {
        let segments = f64::from(self.settings.segments);
        (time * segments).floor().clamp(0.0, segments - 1.0) / segments
    }
}

/// Anchors plus their gated change: positions change fully if the first gate is open, all else in proportion to the
/// second gate.
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
    fn base(&self) -> &dyn Base<T> {
        &self.base
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = self.base.initialize(start, points, random)?;
        if self.has_motion {
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
            self.global.insert(&mut state, start.scene(), random);
            self.local.insert(&mut state, start.scene(), random);
            let count = state.get("anchors.positions")?.rows();
            state.insert(GATES, Tensor::zeros([count, 2]));
            self.base.insert_subject(&mut state, start)?;
        }
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if tensor == GATES {
            return Some(self.settings.gate_rate);
        }
        let of_anchors = Method::<T>::base(self).learning_rate(phase, tensor, scene);
        of_anchors.or_else(|| self.settings.deformation.learning_rate(tensor, scene))
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.gaussians(tape, model, moment).splats)
    }

    fn rows(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(self.gaussians(tape, model, moment).rows_at_moment())
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let spawned = self.gaussians(step.tape, step.model, &moment);
            anchors::compare(step, &spawned, view, None)?;
        }
        if self.moves(step.phase) {
            self.global.regularize(step);
            self.local.regularize(step);
        }
        Ok(())
    }
}
