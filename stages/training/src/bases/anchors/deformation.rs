//! The deformation of anchors and of the Gaussians they spawn: one hexplane field with heads each (Kwak et al. 2025,
//! MoDec-GS, global and local deformation).

use serde::{Deserialize, Serialize};
use shaders::geometry::quaternion;
use shaders::pointwise::adds;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Var};

use super::AnchorSettings;
use super::fields::{ANCHOR_FIELD, FieldSettings, GAUSSIAN_FIELD, Planes};
use crate::bases::bounds;
use crate::bases::heads::{HeadedNetwork, POSITION, in_scene_units};
use crate::bases::hexplane::TimeAxis;
use crate::bases::hexplane::field::{Field, MAX_TEXELS, PlaneWeights};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::effects::Loss;
use crate::method::Step;
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;

const ANCHOR_NETWORK: &str = "anchor_network";
const GAUSSIAN_NETWORK: &str = "gaussian_network";

/// The fields of anchors and of Gaussians, and their training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct DeformationSettings {
    /// The field of the anchors: positions, features, offsets and scales.
    pub anchors: FieldSettings,
    /// The field of the spawned Gaussians: positions and shapes.
    pub gaussians: FieldSettings,
    /// The part of the time axis in use.
    pub time_axis: TimeAxis,
    /// Width of both networks.
    pub width: usize,
    /// Whether every head starts at zero, so that `fine` starts without motion; the published code starts at random.
    pub zero_heads: bool,
    /// Learning rate of the planes, multiplied by the scene's extent in units of published constants.
    pub plane_rate: LogLinear,
    /// Learning rate of the networks, multiplied by the scene's extent in units of published constants.
    pub network_rate: LogLinear,
}

impl Default for DeformationSettings {
    fn default() -> Self {
        let weights = |spatial_smoothness, temporal_smoothness, time_to_one| PlaneWeights {
            spatial_smoothness,
            temporal_smoothness,
            time_to_one,
        };
        let field = |spatial_resolution, regularizers| FieldSettings {
            channels: 16,
            spatial_resolution,
            time_resolution: None,
            multipliers: vec![1, 2],
            regularizers,
        };
        Self {
            anchors: FieldSettings { time_resolution: Some(10), ..field(32, weights(1e-4, 5e-4, 5e-5)) },
            gaussians: field(64, weights(2e-4, 1e-3, 1e-4)),
            time_axis: TimeAxis::Full,
            width: 128,
            zero_heads: true,
            plane_rate: LogLinear { start: 1.6e-3, end: 1.6e-4, steps: 30_000 },
            network_rate: LogLinear::constant(1.6e-4),
        }
    }
}

impl Table for DeformationSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("anchors", &self.anchors)
            .table("gaussians", &self.gaussians)
            .counts(MAX_TEXELS, fields!(self, width))
            .table("plane_rate", &self.plane_rate)
            .table("network_rate", &self.network_rate)
    }
}

impl DeformationSettings {
    /// The regulariser along time, with the reason, if it can act in neither field on a scene with this number of
    /// training times.
    pub(crate) fn idle_loss(&self, time_count: usize) -> Option<(Loss, String)> {
        let of = |field: &FieldSettings, name| field.build(name, self.time_axis, time_count).idle_loss();
        of(&self.anchors, ANCHOR_FIELD).and(of(&self.gaussians, GAUSSIAN_FIELD))
    }

    /// Small, moving from the start, and with regularisers of noticeable weight.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        let weights = PlaneWeights { spatial_smoothness: 0.1, temporal_smoothness: 0.1, time_to_one: 0.1 };
        let field = FieldSettings {
            channels: 2,
            spatial_resolution: 4,
            time_resolution: Some(6),
            multipliers: vec![1, 2],
            regularizers: weights,
        };
        Self { anchors: field.clone(), gaussians: field, width: 8, zero_heads: false, ..Self::default() }
    }

    /// The learning rate of a tensor of either field; the boxes are not trained.
    pub(crate) fn learning_rate(&self, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if [ANCHOR_FIELD, GAUSSIAN_FIELD].iter().any(|field| Field::is_plane(field, tensor)) {
            return Some(self.plane_rate.scaled(scene.relative_extent()));
        }
        let is_network = [ANCHOR_NETWORK, GAUSSIAN_NETWORK].iter().any(|network| belongs(tensor, network));
        is_network.then(|| self.network_rate.scaled(scene.relative_extent()))
    }
}

/// Changes of M anchors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnchorChange {
    /// [M, 3] displacements, scene units.
    pub positions: Var,
    /// [M, F] changes of features.
    pub features: Var,
    /// [M, 3K] changes of offsets.
    pub offsets: Var,
    /// [M, 6], added to the logarithmic scales.
    pub log_scales: Var,
}

/// The field that moves anchors.
pub(crate) struct AnchorDeformation {
    planes: Planes,
    network: HeadedNetwork,
    zero_heads: bool,
}

impl AnchorDeformation {
    /// The field of anchors of these sizes.
    pub(crate) fn new(settings: &DeformationSettings, anchors: &AnchorSettings) -> Self {
        let planes = Planes::new(ANCHOR_FIELD, &settings.anchors, settings.time_axis);
        let heads = vec![(POSITION, 3), ("feature", anchors.features), ("offset", 3 * anchors.offsets), ("scale", 6)];
        let network = HeadedNetwork::new(ANCHOR_NETWORK, settings.anchors.features(), settings.width, heads);
        Self { planes, network, zero_heads: settings.zero_heads }
    }

    /// Adds planes and network.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, scene: &SceneFacts, random: Streams) {
        self.planes.insert(state, scene, random);
        self.network.insert(state, self.zero_heads, random);
    }

    /// The changes of anchors at canonical positions [M, 3] at a time in [0, 1]; the network counts displacements in
    /// units of [`SceneFacts::unit_world`].
    pub(crate) fn at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        positions: Var,
        time: f64,
    ) -> AnchorChange {
        let hidden = self.hidden(tape, model, scene, positions, time);
        let heads = self.network.heads(tape, model, &[POSITION, "feature", "offset", "scale"], hidden);
        let positions = in_scene_units(tape, heads[0], scene.unit_world);
        AnchorChange { positions, features: heads[1], offsets: heads[2], log_scales: heads[3] }
    }

    /// Positions [M, 3] in the field's box, as [−1, 1].
    pub(crate) fn inside<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var) -> Var {
        bounds::inside(tape, model, ANCHOR_FIELD, positions)
    }

    /// The displacements [M, 3] of [`AnchorDeformation::at`] alone.
    pub(crate) fn displacements<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        positions: Var,
        time: f64,
    ) -> Var {
        let hidden = self.hidden(tape, model, scene, positions, time);
        self.network.displacements(tape, model, hidden, scene.unit_world)
    }

    /// Adds the regularisers of the planes.
    pub(crate) fn regularize<T: Real>(&self, step: &mut Step<'_, T>) {
        self.planes.regularize(step);
    }

    fn hidden<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        positions: Var,
        time: f64,
    ) -> Var {
        let features = self.planes.field(scene).at(tape, model, positions, time);
        self.network.hidden(tape, model, features)
    }
}

/// The field that moves spawned Gaussians.
pub(crate) struct GaussianDeformation {
    planes: Planes,
    network: HeadedNetwork,
    zero_heads: bool,
}

impl GaussianDeformation {
    /// The field with these settings.
    pub(crate) fn new(settings: &DeformationSettings) -> Self {
        let planes = Planes::new(GAUSSIAN_FIELD, &settings.gaussians, settings.time_axis);
        let heads = vec![(POSITION, 3), ("scale", 3), ("rotation", 4)];
        let network = HeadedNetwork::new(GAUSSIAN_NETWORK, settings.gaussians.features(), settings.width, heads);
        Self { planes, network, zero_heads: settings.zero_heads }
    }

    /// Adds planes and network.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, scene: &SceneFacts, random: Streams) {
        self.planes.insert(state, scene, random);
        self.network.insert(state, self.zero_heads, random);
    }

    /// Gaussians at a time in [0, 1]: the outputs of the heads are added to positions, logarithmic scales and unit
    /// quaternions. The network counts displacements in units of [`SceneFacts::unit_world`].
    pub(crate) fn deform<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        scene: &SceneFacts,
        spawned: SplatVars,
        time: f64,
    ) -> SplatVars {
        let features = self.planes.field(scene).at(tape, model, spawned.positions, time);
        let hidden = self.network.hidden(tape, model, features);
        let (log_scales, rotations) = spawned.shape.scales_and_rotations().expect("anchors spawn both");
        let rotations = quaternion::normalize(tape, rotations);
        let mut changes = self.network.heads(tape, model, &[POSITION, "scale", "rotation"], hidden);
        changes[0] = in_scene_units(tape, changes[0], scene.unit_world);
        let attributes = [spawned.positions, log_scales, rotations];
        let pairs: Vec<[Var; 2]> = attributes.into_iter().zip(changes).map(|(a, change)| [a, change]).collect();
        let moved = adds(tape, &pairs);
        let shape = ShapeVars::ScaleRotation { log_scales: moved[1], rotations: moved[2] };
        SplatVars { positions: moved[0], shape, ..spawned }
    }

    /// Adds the regularisers of the planes.
    pub(crate) fn regularize<T: Real>(&self, step: &mut Step<'_, T>) {
        self.planes.regularize(step);
    }
}
