//! The hexplane fields of anchors and Gaussians: sizes, boxes and planes.

use serde::{Deserialize, Serialize};
use shaders::tape::Real;

use super::ANCHORS;
use crate::bases::bounds::Bounds;
use crate::bases::hexplane::TimeAxis;
use crate::bases::hexplane::field::{Field, MAX_TEXELS, PlaneWeights};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams};
use crate::method::Step;
use crate::model::ModelState;

/// The name of the field of the anchors.
pub(super) const ANCHOR_FIELD: &str = "anchor_field";
/// The name of the field of the Gaussians.
pub(super) const GAUSSIAN_FIELD: &str = "gaussian_field";
/// Maximum number of texels along time that follows from the number of frames (published code).
const MOST_TIME_TEXELS: usize = 100;

/// The planes of one field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FieldSettings {
    /// Channels per plane.
    pub channels: usize,
    /// Texels along x, y and z at multiplier 1.
    pub spatial_resolution: usize,
    /// Texels along time in the published code's counting, of which it reads half; unset: half the number of distinct
    /// training times, at most 100 as in its settings for DyCheck and HyperNeRF.
    pub time_resolution: Option<usize>,
    /// Multipliers of the spatial resolution, one set of planes each.
    pub multipliers: Vec<usize>,
    /// Weights of the planes' regularisers.
    pub regularizers: PlaneWeights,
}

impl FieldSettings {
    /// The field on a scene with this number of training times.
    pub(super) fn build(&self, name: &'static str, axis: TimeAxis, time_count: usize) -> Field {
        let time_resolution = self.time_resolution.unwrap_or(time_count.div_ceil(2).min(MOST_TIME_TEXELS));
        Field::new(name, self.channels, [self.spatial_resolution; 3], time_resolution, &self.multipliers, axis)
    }

    /// Features per point.
    pub(super) fn features(&self) -> usize {
        self.channels * self.multipliers.len()
    }
}

impl Table for FieldSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .counts(MAX_TEXELS, fields!(self, channels, spatial_resolution))
            .counts(MAX_TEXELS, [("time_resolution", self.time_resolution.unwrap_or(1))])
            .list_of_counts(MAX_TEXELS, "multipliers", &self.multipliers)
            .table("regularizers", &self.regularizers)
    }
}

/// The planes of one field on a scene whose number of frames is known later.
pub(super) struct Planes {
    name: &'static str,
    settings: FieldSettings,
    axis: TimeAxis,
}

impl Planes {
    /// The planes of the field of that name.
    pub(super) fn new(name: &'static str, settings: &FieldSettings, axis: TimeAxis) -> Self {
        Self { name, settings: settings.clone(), axis }
    }

    /// The field on a scene.
    pub(super) fn field(&self, scene: &SceneFacts) -> Field {
        self.settings.build(self.name, self.axis, scene.time_count)
    }

    pub(super) fn insert<T: Real>(&self, state: &mut ModelState<T>, scene: &SceneFacts, random: Streams) {
        self.field(scene).insert_planes(state, random);
    }

    /// Adds the regularisers.
    pub(super) fn regularize<T: Real>(&self, step: &mut Step<'_, T>) {
        self.field(step.scene).regularize(step, &self.settings.regularizers);
    }
}

/// Adds the box around the anchors as the box of both fields. Call it on the model's initial state.
pub(crate) fn insert_boxes<T: Real>(state: &mut ModelState<T>) -> anyhow::Result<()> {
    let positions = state.get(&format!("{ANCHORS}.positions"))?;
    let row = |index: usize| std::array::from_fn(|axis| positions.row(index)[axis].to_f64() as f32);
    let positions: Vec<[f32; 3]> = (0..positions.rows()).map(row).collect();
    let bounds = Bounds::around(&positions);
    [ANCHOR_FIELD, GAUSSIAN_FIELD].iter().for_each(|field| bounds.insert(state, field));
    Ok(())
}
