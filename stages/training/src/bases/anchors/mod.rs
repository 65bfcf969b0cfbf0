//! Anchors that spawn Gaussians for every view (Lu et al. 2024, Scaffold-GS), and hexplane fields that move both (Kwak
//! et al. 2025, MoDec-GS).
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `anchors.positions` | [N, 3] | scene units; not trained |
//! | `anchors.features` | [N, F] | inputs of the networks |
//! | `anchors.offsets` | [N, 3K] | offsets of the K Gaussians, in units of the first three scales |
//! | `anchors.log_scales` | [N, 6] | logarithms: three scales of the offsets, three of the Gaussians |
//! | `views.{opacity, shape, color}.{0, 1}` | | networks of feature and view direction |
//!
//! With the effect `seed-from-masks`, the Gaussians of the moving subject are stored beside the anchors (`gaussians.*`).

mod deformation;
mod fields;
mod growth;
mod initial;
mod subject;
#[cfg(test)]
mod tests;
mod views;

pub(crate) use crate::schedule::{COARSE, FINE};
pub(crate) use deformation::{AnchorChange, AnchorDeformation, DeformationSettings, GaussianDeformation};
pub(crate) use fields::{FieldSettings, insert_boxes};
pub(crate) use growth::AnchorGrowth;
pub(crate) use initial::{insert_anchors, voxels};
pub(crate) use views::{SpawnedGaussians, insert_view_networks, spawn};

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::mul;
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape, Var};

use crate::bases::gaussians::{self, GAUSSIANS};
use crate::bases::seeds;
use crate::bases::static_mask::MAY_MOVE;
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams, TrainingView};
use crate::effects::{Effect, VIEW_DEPENDENT_COLOR};
use crate::method::{Base, Moment, Observed, Start, Step, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::{Density, Harmonics, Loss, Shared};

/// The population of anchors.
pub(crate) const ANCHORS: &str = "anchors";
/// The viewing direction is an input of the view networks, as published. Where colours do not depend on it and every
/// instant has a single camera, it only identifies the instant, and the networks could fit the instants without any
/// motion.
pub(crate) const VIEW_DIRECTION: Effect =
    Effect { about: "the networks of the anchors see the viewing direction", ..VIEW_DEPENDENT_COLOR };
/// Maximum values per anchor, far beyond any use: a larger value is a typing error.
const MAX_VALUES: usize = 8192;

/// Settings of anchors, their networks and their training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct AnchorSettings {
    /// Side of the voxels, scene units (times [`SceneFacts::unit_world`]); each holds at most one initial anchor.
    pub voxel_size: f64,
    /// Values of an anchor's feature.
    pub features: usize,
    /// Gaussians per anchor (K).
    pub offsets: usize,
    /// Width of the view networks.
    pub width: usize,
    /// Criteria for new anchors; the table `density` sets their schedule and number.
    pub growth: Growth,
    /// Learning rate of the features.
    pub feature_rate: f64,
    /// Learning rate of the offsets, multiplied by the scene's extent in units of published constants.
    pub offset_rate: LogLinear,
    /// Learning rate of the logarithmic scales.
    pub scale_rate: f64,
    /// Learning rate of the opacity network.
    pub opacity_network_rate: LogLinear,
    /// Learning rate of the shape network.
    pub shape_network_rate: LogLinear,
    /// Learning rate of the colour network.
    pub color_network_rate: LogLinear,
}

/// Criteria for new anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Growth {
    /// Number of cell sizes, each a quarter of the previous one with twice its gradient threshold.
    pub levels: u32,
    /// Side of the largest cells, in voxels.
    pub largest_cell: f64,
    /// Share of an interval's iterations in which an anchor must be in view before it may be pruned; its Gaussians must
    /// be visible in half that share before they may add anchors.
    pub success: f64,
    /// Statistics are collected from this iteration on.
    pub statistics_from: u64,
}

impl Default for AnchorSettings {
    fn default() -> Self {
        Self {
            voxel_size: 0.01,
            features: 32,
            offsets: 10,
            width: 32,
            growth: Growth::default(),
            feature_rate: 7.5e-3,
            offset_rate: LogLinear { start: 1e-2, end: 1e-4, steps: 30_000 },
            scale_rate: 7e-3,
            opacity_network_rate: LogLinear { start: 2e-3, end: 2e-5, steps: 30_000 },
            shape_network_rate: LogLinear::constant(4e-3),
            color_network_rate: LogLinear { start: 8e-3, end: 5e-5, steps: 30_000 },
        }
    }
}

impl Default for Growth {
    fn default() -> Self {
        Self { levels: 3, largest_cell: 16.0, success: 0.7, statistics_from: 500 }
    }
}

impl Table for AnchorSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .positive(fields!(self, voxel_size, growth.largest_cell))
            .rates(fields!(self, feature_rate, scale_rate))
            .counts(MAX_VALUES, fields!(self, features, offsets, width))
            // Cells of the tenth level are a millionth of the largest.
            .at_most(10, fields!(self, growth.levels))
            .require("growth.success", (0.0..1.0).contains(&self.growth.success), "must be in [0, 1)")
            .table("offset_rate", &self.offset_rate)
            .table("opacity_network_rate", &self.opacity_network_rate)
            .table("shape_network_rate", &self.shape_network_rate)
            .table("color_network_rate", &self.color_network_rate)
    }
}

impl AnchorSettings {
    /// Small, with voxels that separate the points of the test scene, and with statistics from the first step on.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        let growth = Growth { statistics_from: 0, ..Growth::default() };
        Self { voxel_size: 0.05, features: 4, offsets: 4, width: 16, growth, ..Self::default() }
    }

    /// The learning rate of a tensor of the anchors or their networks.
    pub(crate) fn learning_rate(&self, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let (owner, rest) = tensor.split_once('.')?;
        match (owner, rest.split('.').next()?) {
            (ANCHORS, "features") => Some(LogLinear::constant(self.feature_rate)),
            (ANCHORS, "offsets") => Some(self.offset_rate.scaled(scene.relative_extent())),
            (ANCHORS, "log_scales") => Some(LogLinear::constant(self.scale_rate)),
            (views::VIEWS, "opacity") => Some(self.opacity_network_rate),
            (views::VIEWS, "shape") => Some(self.shape_network_rate),
            (views::VIEWS, "color") => Some(self.color_network_rate),
            _ => None,
        }
    }
}

/// Shared defaults of all methods on anchors: the published settings for DyCheck.
pub(crate) fn shared_defaults() -> Shared {
    let density = Density { from: 1500, until: 15_000, min_opacity: 0.01, ..Density::default() };
    let mut shared = Shared {
        iterations: BTreeMap::from([(COARSE.into(), 3000), (FINE.into(), 20_000)]),
        batch: 2,
        loss: Loss { lambda_dssim: 1.0 / 6.0 },
        harmonics: Harmonics { degree: 0, ..Harmonics::default() },
        density,
        ..Shared::default()
    };
    shared.initial_points.max_count = 40_000;
    shared
}

/// The published loss L1 + 0.2·(1 − SSIM) is this multiple of the loss of all methods, (1 − λ)·L1 + λ·(1 − SSIM), at
/// λ = 1/6.
const PHOTOMETRIC_WEIGHT: f64 = 1.2;

/// Renders a view and adds its photometric loss and, for the Gaussians of the subject, the loss `silhouette`. With a
/// `mask` [H, W, 3], used in warm-ups, only the photometric loss is added, on both images multiplied by the mask.
pub(crate) fn compare<T: Real>(
    step: &mut Step<'_, T>,
    shown: &SpawnedGaussians,
    view: &TrainingView<T>,
    mask: Option<Var>,
) -> anyhow::Result<()> {
    let observed = Observed::Rows(shown.rows());
    let Some(mask) = mask else {
        let subject = shown.subject(step, view);
        step.compare_subject(&shown.splats, subject, view, observed, PHOTOMETRIC_WEIGHT)?;
        return Ok(());
    };
    let rendered = step.render(&shown.splats, None, view, observed)?;
    let target = step.tape.constant(view.image.clone());
    let [color, target] = [rendered.color, target].map(|image| mul(step.tape, image, mask));
    step.photometric_to(PHOTOMETRIC_WEIGHT, color, target);
    Ok(())
}

/// Static anchors and their training.
pub(crate) struct AnchoredGaussians {
    shared: Shared,
    settings: AnchorSettings,
    starts_at_zero: &'static [&'static str],
}

impl AnchoredGaussians {
    /// The base with these settings.
    pub(crate) fn new(shared: &Shared, settings: &AnchorSettings) -> Self {
        Self { shared: shared.clone(), settings: settings.clone(), starts_at_zero: &["offsets"] }
    }

    /// The base whose new anchors have zeros in these attributes.
    pub(crate) fn with_zeros(self, starts_at_zero: &'static [&'static str]) -> Self {
        Self { starts_at_zero, ..self }
    }

    /// The Gaussians that the stored anchors spawn for a camera.
    pub(crate) fn spawn<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        camera: &PinholeCamera,
    ) -> SpawnedGaussians {
        spawn(tape, model, &Anchors::stored(model), None, camera)
    }

    /// Adds the initial tensors, with anchors at these positions.
    pub(crate) fn insert<T: Real>(
        &self,
        state: &mut ModelState<T>,
        positions: Vec<[f32; 3]>,
        scene: &SceneFacts,
        random: Streams,
    ) {
        insert_anchors(state, positions, &self.settings, scene);
        let view_direction = self.shared.effects.has(VIEW_DIRECTION.name);
        insert_view_networks(state, &self.settings, view_direction, random);
    }

    /// Adds the Gaussians of the subject, with the effect `seed-from-masks`.
    pub(crate) fn insert_subject<T: Real>(&self, state: &mut ModelState<T>, start: &Start<'_>) -> anyhow::Result<()> {
        if self.shared.has_seeds() {
            seeds::insert(state, &self.shared, start, MAY_MOVE)?;
            seeds::extend_box(state, fields::GAUSSIAN_FIELD)?;
        }
        Ok(())
    }

    /// One position for every voxel that holds a point.
    pub(crate) fn positions(&self, points: &PointCloud, scene: &SceneFacts) -> Vec<[f32; 3]> {
        let size = self.settings.voxel_size * scene.unit_world;
        voxels(&points.positions, size).into_iter().map(|(center, _)| center).collect()
    }
}

impl<T: Real> Base<T> for AnchoredGaussians {
    fn phases(&self) -> Vec<Phase> {
        [COARSE, FINE].map(|name| self.shared.phase(name)).to_vec()
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        self.insert(&mut state, self.positions(points, start.scene()), start.scene(), random);
        Ok(state)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let of_subject = gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene);
        of_subject.or_else(|| self.settings.learning_rate(tensor, scene))
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.spawn(tape, model, moment.camera).splats)
    }

    fn rows(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(self.spawn(tape, model, moment.camera).rows_at_moment())
    }

    fn hooks(&self, _phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        let growth = AnchorGrowth::new(density, &self.settings, *schedule_scale, scene.unit_world);
        vec![Box::new(growth.with_zeros(self.starts_at_zero))]
    }
}

/// N anchors at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchors {
    /// [N, 3] world positions, scene units.
    pub positions: Var,
    /// [N, F] features.
    pub features: Var,
    /// [N, 3K] offsets in units of the first three scales.
    pub offsets: Var,
    /// [N, 6] natural logarithms of the scales.
    pub log_scales: Var,
}

impl Anchors {
    /// The stored anchors of the model.
    pub(crate) fn stored(model: &Variables) -> Self {
        let var = |attribute: &str| model.get(&format!("{ANCHORS}.{attribute}"));
        Self {
            positions: var("positions"),
            features: var("features"),
            offsets: var("offsets"),
            log_scales: var("log_scales"),
        }
    }
}
