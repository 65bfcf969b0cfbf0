//! Canonical Gaussians moved by a hexplane field and a small network: 4DGaussians (Wu et al. 2024).
//!
//! There are two phases. `coarse` fits static Gaussians to all frames; it depends only on the box of the field, so
//! methods can share it. `fine` adds the field and the network and trains all tensors.

pub(crate) mod field;
mod network;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Var};

pub(crate) use crate::schedule::{COARSE, FINE};
pub(crate) use field::TimeAxis;
pub(crate) use network::{FurtherHead, Heads, MovedPoints};

use crate::bases::bounds::Bounds;
use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::bases::seeds;
use crate::bases::static_mask;
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::effects::{self, Effect, Need};
use crate::method::{Base, Moment, SharedPhase, Start, Step, StepHook};
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::{LogLinear, Phase};
use crate::shared::{Density, LearningRates, Loss, Shared};
use field::{Field, MAX_TEXELS, PlaneWeights};
use network::Network;

/// The name of the field.
const FIELD: &str = "field";

/// Without this effect there is neither field nor network, and `fine` continues like `coarse`.
pub(crate) const MOTION: Effect =
    Effect::new("motion", "a hexplane field moves the Gaussians", &[Need::Times(2), Need::Motion]);

/// The shared phase `coarse` of all methods on this base; it reads nothing of [`HexplaneSettings`].
pub(crate) fn shared_coarse(shared: &Shared) -> SharedPhase {
    SharedPhase {
        base: "hexplane",
        phase: COARSE,
        settings: serde_json::json!({}),
        iterations: BTreeMap::from([(COARSE, shared.iterations_of(COARSE))]),
        effects: &[],
        losses: &[],
    }
}

/// Settings of the field, the network and their training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct HexplaneSettings {
    /// Channels per plane.
    pub channels: usize,
    /// Texels along x, y and z at multiplier 1.
    pub spatial_resolution: usize,
    /// Texels along time in the published code's counting (it reads only half of them, see `time_axis`); unset: half
    /// the number of distinct training times, as in its D-NeRF settings.
    pub time_resolution: Option<usize>,
    /// Multipliers of the spatial resolution, one set of planes each.
    pub multipliers: Vec<usize>,
    /// Width of the network.
    pub width: usize,
    /// The part of the time axis in use.
    pub time_axis: TimeAxis,
    /// The attributes that the network changes.
    pub heads: Heads,
    /// Whether the last layer of every head starts at zero, so that `fine` starts without motion; the published code
    /// draws it at random.
    pub zero_heads: bool,
    /// Weight of the second differences of the spatial planes.
    pub spatial_smoothness: f64,
    /// Weight of the second differences along time.
    pub temporal_smoothness: f64,
    /// Weight of the distance of the time planes from 1.
    pub time_to_one: f64,
    /// Learning rate of the planes, multiplied by the scene's extent in units of published constants.
    pub plane_rate: LogLinear,
    /// Learning rate of the network, multiplied by the scene's extent in units of published constants.
    pub network_rate: LogLinear,
}

impl Default for HexplaneSettings {
    fn default() -> Self {
        Self {
            channels: 32,
            spatial_resolution: 64,
            time_resolution: None,
            multipliers: vec![1, 2],
            width: 64,
            time_axis: TimeAxis::Full,
            heads: Heads::default(),
            zero_heads: false,
            spatial_smoothness: 1e-4,
            temporal_smoothness: 1e-2,
            time_to_one: 1e-4,
            plane_rate: LogLinear { start: 1.6e-3, end: 1.6e-5, steps: 20_000 },
            network_rate: LogLinear { start: 1.6e-4, end: 1.6e-6, steps: 20_000 },
        }
    }
}

impl Table for HexplaneSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .counts(MAX_TEXELS, fields!(self, channels, spatial_resolution, width))
            .counts(MAX_TEXELS, [("time_resolution", self.time_resolution.unwrap_or(1))])
            .list_of_counts(MAX_TEXELS, "multipliers", &self.multipliers)
            .require("heads", self.heads != Heads::NONE, "must not all be false: the deformation would move nothing")
            .not_negative(fields!(self, spatial_smoothness, temporal_smoothness, time_to_one))
            .table("plane_rate", &self.plane_rate)
            .table("network_rate", &self.network_rate)
    }
}

impl HexplaneSettings {
    /// Small, with every head, and regularisers of noticeable weight.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            channels: 2,
            spatial_resolution: 4,
            multipliers: vec![1, 2],
            width: 16,
            heads: Heads { position: true, scale: true, rotation: true, opacity: true, harmonics: true },
            spatial_smoothness: 0.1,
            temporal_smoothness: 0.1,
            time_to_one: 0.1,
            ..Self::default()
        }
    }

    fn field(&self, time_count: usize) -> Field {
        let time_resolution = self.time_resolution.unwrap_or(time_count.div_ceil(2));
        let spatial = [self.spatial_resolution; 3];
        Field::new(FIELD, self.channels, spatial, time_resolution, &self.multipliers, self.time_axis)
    }

    /// [`Field::idle_loss`] of the field on a scene with this number of training times.
    pub(crate) fn idle_loss(&self, time_count: usize) -> Option<(effects::Loss, String)> {
        self.field(time_count).idle_loss()
    }

    /// Shared defaults from the published D-NeRF settings: L1 alone, 2000 random points, pruning only beyond 200 000
    /// Gaussians.
    pub(crate) fn shared_defaults() -> Shared {
        let density =
            Density { max_count: 360_000, prune_interval: 8000, prune_above_count: 200_000, ..Density::default() };
        let mut shared = Shared {
            iterations: BTreeMap::from([(COARSE.into(), 3000), (FINE.into(), 20_000)]),
            loss: Loss { lambda_dssim: 0.0 },
            density,
            ..Shared::default()
        };
        shared.initial_points.random_count = 2000;
        shared.learning_rates = LearningRates::default();
        shared.learning_rates.position.steps = 20_000;
        shared
    }
}

/// The base: canonical Gaussians with a field and a network.
pub(crate) struct HexplaneGaussians {
    shared: Shared,
    settings: HexplaneSettings,
    further_heads: Vec<FurtherHead>,
}

impl HexplaneGaussians {
    /// The base with these settings.
    pub(crate) fn new(shared: &Shared, settings: HexplaneSettings) -> Self {
        Self { shared: shared.clone(), settings, further_heads: Vec::new() }
    }

    /// The base with heads that move no attribute; only [`HexplaneGaussians::further_head`] evaluates them.
    pub(crate) fn with_further_heads(self, further_heads: Vec<FurtherHead>) -> Self {
        Self { further_heads, ..self }
    }

    /// Whether Gaussians move in a phase. Without the effect `motion` there is neither field nor network, and `fine`
    /// continues like `coarse`.
    pub(crate) fn moves(&self, phase: &str) -> bool {
        phase == FINE && self.shared.effects.has(MOTION.name)
    }

    /// Moves canonical points [N, 3] to a time in [0, 1], in the same way as [`Base::splats`] moves the Gaussians that may
    /// move.
    pub(crate) fn move_points<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        positions: Var,
        time: f64,
    ) -> MovedPoints {
        let features = self.field(scene).at(tape, model, positions, time);
        self.network(scene).move_points(tape, model, features, positions)
    }

    /// The output of a further head for moved points, from their hidden features ([`MovedPoints`]).
    pub(crate) fn further_head<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        head: &str,
        hidden: Var,
    ) -> Var {
        self.network(scene).further_head(tape, model, head, hidden)
    }

    /// The regularisers of the planes, in `fine`.
    pub(crate) fn regularize<T: Real>(&self, step: &mut Step<'_, T>) {
        if !self.moves(step.phase) {
            return;
        }
        let HexplaneSettings { spatial_smoothness, temporal_smoothness, time_to_one, .. } = self.settings;
        let weights = PlaneWeights { spatial_smoothness, temporal_smoothness, time_to_one };
        self.field(step.scene).regularize(step, &weights);
    }

    fn field(&self, scene: &SceneFacts) -> Field {
        self.settings.field(scene.time_count)
    }

    fn network(&self, scene: &SceneFacts) -> Network {
        let sh_count = (self.shared.harmonics.degree + 1).pow(2);
        let features = self.field(scene).features();
        Network::new(
            features,
            self.settings.width,
            self.settings.heads,
            sh_count,
            &self.further_heads,
            scene.unit_world,
        )
    }
}

impl<T: Real> Base<T> for HexplaneGaussians {
    fn phases(&self) -> Vec<Phase> {
        [COARSE, FINE].map(|name| self.shared.phase(name)).to_vec()
    }

    /// Gaussians on the points, and the box of the field.
    fn initialize(&self, start: &Start<'_>, points: &PointCloud, _: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        gaussians::insert_initial(&mut state, &self.shared, start.scene(), points);
        Bounds::around(&points.positions).insert(&mut state, FIELD);
        Ok(state)
    }

    /// Adds the field and the network at the start of `fine`.
    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if self.moves(phase) {
            let scene = start.scene();
            self.field(scene).insert_planes(&mut state, random);
            self.network(scene).insert(&mut state, self.settings.zero_heads, random);
            static_mask::insert(&mut state, &self.shared, start)?;
            seeds::extend_box(&mut state, FIELD)?;
        }
        Ok(state)
    }

    /// The box is never trained; the field and the network exist only in `fine`.
    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if Field::is_plane(FIELD, tensor) {
            return Some(self.settings.plane_rate.scaled(scene.relative_extent()));
        }
        if belongs(tensor, network::NETWORK) {
            return Some(self.settings.network_rate.scaled(scene.relative_extent()));
        }
        gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene)
    }

    /// Moved Gaussians in `fine`, canonical ones before.
    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        let canonical = gaussians::static_splats(tape, model, GAUSSIANS, moment.sh_degree);
        if !self.moves(moment.phase) {
            return Ok(canonical);
        }
        Ok(static_mask::move_some(tape, model, moment, canonical, |tape, some, _| {
            let features = self.field(moment.scene).at(tape, model, some.positions, moment.time);
            self.network(moment.scene).deform(tape, model, features, some, moment.sh_degree)
        }))
    }

    /// Density control, the same in both phases; it never resets opacities at the start.
    fn hooks(&self, phase: &str, _scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        let control = AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, false);
        vec![Box::new(control.with_surveys(&self.shared, phase == FINE))]
    }
}
