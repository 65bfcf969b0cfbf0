//! The hexplane field as tensors of a model: planes over pairs of (x, y, z, t) in a box (Wu et al. 2024, section 4.2).

use serde::{Deserialize, Serialize};
use shaders::networks::hexplane::{HexplaneShape, PlaneMean, hexplane, is_time_plane, plane_means};
use shaders::tape::{Real, Tape, Var};

use crate::bases::bounds;
use crate::bases::layers::uniform;
use crate::check::{Checks, Table, fields};
use crate::data::Streams;
use crate::effects::Loss;
use crate::method::Step;
use crate::model::{ModelState, Variables};

/// Initial values of the spatial planes (published code); time planes start at 1, which means "no change".
const SPATIAL_START: [f64; 2] = [0.1, 0.5];
/// Infix of the planes' tensor names.
const PLANE: &str = ".plane_";
/// Maximum size: a plane of 4096² texels with 32 channels takes 2 GB, so a larger value is a typing error.
pub(crate) const MAX_TEXELS: usize = 4096;

/// Second differences of the spatial planes.
pub(crate) const SPATIAL_SMOOTHNESS: Loss = Loss::of("motion", "spatial_smoothness").stays(PUBLISHED);
/// Second differences of the time planes along time.
pub(crate) const TEMPORAL_SMOOTHNESS: Loss = Loss::of("motion", "temporal_smoothness").stays(PUBLISHED);
/// The distance of the time planes to one.
pub(crate) const TIME_TO_ONE: Loss = Loss::of("motion", "time_to_one").stays(PUBLISHED);
/// The reason why the regularisers are kept even if they are inert.
const PUBLISHED: &str = "part of the published objective of 4DGaussians, which a baseline has to keep";

/// The mapping of normalised time in [0, 1] to the time axis of the planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum TimeAxis {
    /// The whole axis with half the texels: the used capacity of the published code without idle texels.
    Full,
    /// The upper half only: the published code never reads the lower half.
    UpperHalf,
}

/// Weights of the regularisers of a field's planes; 0 disables one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct PlaneWeights {
    /// Weight of Σ over spatial planes of the mean squared second difference along the height axis.
    pub spatial_smoothness: f64,
    /// Weight of Σ over time planes of the mean squared second difference along time.
    pub temporal_smoothness: f64,
    /// Weight of Σ over time planes of mean |1 − P|.
    pub time_to_one: f64,
}

impl Table for PlaneWeights {
    fn check(&self) -> Checks {
        Checks::default().not_negative(fields!(self, spatial_smoothness, temporal_smoothness, time_to_one))
    }
}

/// A field's planes: sizes, and the names of their tensors.
///
/// A field called `field` has the box `field.bounds` ([`crate::bases::bounds`]) and
/// the planes `field.plane_{scale}_{pair}`.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    name: &'static str,
    shape: HexplaneShape,
    time_axis: TimeAxis,
}

impl Field {
    /// A field whose time axis has `time_resolution` texels in the published code's counting (see [`TimeAxis`]).
    pub(crate) fn new(
        name: &'static str,
        channels: usize,
        spatial: [usize; 3],
        time_resolution: usize,
        multipliers: &[usize],
        axis: TimeAxis,
    ) -> Self {
        let time = match axis {
            TimeAxis::Full => time_resolution.div_ceil(2),
            TimeAxis::UpperHalf => time_resolution,
        };
        let [x, y, z] = spatial;
        let shape = HexplaneShape { channels, resolution: [x, y, z, time.max(1)], multipliers: multipliers.to_vec() };
        Self { name, shape, time_axis: axis }
    }

    /// Features per point.
    pub(crate) fn features(&self) -> usize {
        self.shape.features()
    }

    /// Whether a tensor is one of the planes of the field of that name.
    pub(crate) fn is_plane(name: &str, tensor: &str) -> bool {
        tensor.strip_prefix(name).is_some_and(|rest| rest.starts_with(PLANE))
    }

    /// Whether some of the chosen planes have three texels in a row along their height axis.
    fn has_second_differences(&self, chosen: fn(usize) -> bool) -> bool {
        self.shape.plane_shapes().iter().enumerate().any(|(index, [height, ..])| chosen(index) && *height > 2)
    }

    /// The regulariser along time if it cannot act, with the reason.
    pub(crate) fn idle_loss(&self) -> Option<(Loss, String)> {
        let [.., texels] = self.shape.resolution;
        let reason = format!("nothing to smooth, {texels} texels along time where 3 are needed");
        (!self.has_second_differences(is_time_plane)).then_some((TEMPORAL_SMOOTHNESS, reason))
    }

    /// Adds the planes.
    pub(crate) fn insert_planes<T: Real>(&self, state: &mut ModelState<T>, random: Streams) {
        for (index, shape) in self.shape.plane_shapes().iter().enumerate() {
            let [low, high] = if is_time_plane(index) { [1.0, 1.0] } else { SPATIAL_START };
            let name = self.plane_name(index);
            let plane = uniform(shape, low, high, &mut random.tensor(&name));
            state.insert(name, plane);
        }
    }

    /// Features [N, F] of positions [N, 3] (world) at a time in [0, 1].
    pub(crate) fn at<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var, time: f64) -> Var {
        let inside = self.inside(tape, model, positions);
        let time = match self.time_axis {
            TimeAxis::Full => 2.0 * time - 1.0,
            TimeAxis::UpperHalf => time,
        };
        hexplane(tape, &self.planes(model, |_| true), inside, time)
    }

    /// Positions [N, 3] (world) in the field's box, as [−1, 1].
    pub(crate) fn inside<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var) -> Var {
        bounds::inside(tape, model, self.name, positions)
    }

    /// Adds the regularisers of the planes to a step's losses; one of weight 0, or of differences that no
    /// plane has, is not evaluated.
    ///
    /// The weights of the two time regularisers are adapted so that they equal the published code's, whose means
    /// include the idle lower half (see [`TimeAxis`]).
    pub(crate) fn regularize<T: Real>(&self, step: &mut Step<'_, T>, weights: &PlaneWeights) {
        let time_factor = match self.time_axis {
            TimeAxis::Full => 0.5,
            TimeAxis::UpperHalf => 1.0,
        };
        let is_space: fn(usize) -> bool = |index| !is_time_plane(index);
        let PlaneWeights { spatial_smoothness, temporal_smoothness, time_to_one } = *weights;
        let all = [
            (SPATIAL_SMOOTHNESS.name, spatial_smoothness, PlaneMean::SecondDifference, is_space),
            (TEMPORAL_SMOOTHNESS.name, time_factor * temporal_smoothness, PlaneMean::SecondDifference, is_time_plane),
            (TIME_TO_ONE.name, time_factor * time_to_one, PlaneMean::DistanceToOne, is_time_plane),
        ];
        let acts = |(_, weight, mean, chosen): &(_, f64, PlaneMean, fn(usize) -> bool)| {
            *weight > 0.0 && (*mean != PlaneMean::SecondDifference || self.has_second_differences(*chosen))
        };
        let wanted: Vec<_> = all.into_iter().filter(acts).collect();
        if wanted.is_empty() {
            return;
        }
        let term = |(.., mean, chosen): &(_, _, PlaneMean, fn(usize) -> bool)| (*mean, self.planes(step.model, chosen));
        let terms: Vec<_> = wanted.iter().map(term).collect();
        let values = plane_means(step.tape, &terms);
        let weighted = wanted.iter().zip(values).map(|((name, weight, ..), value)| (*name, *weight, value));
        step.add_losses(&weighted.collect::<Vec<_>>());
    }

    fn planes(&self, model: &Variables, chosen: impl Fn(usize) -> bool) -> Vec<Var> {
        let count = 6 * self.shape.multipliers.len();
        (0..count).filter(|&index| chosen(index)).map(|index| model.get(&self.plane_name(index))).collect()
    }

    fn plane_name(&self, index: usize) -> String {
        const PAIRS: [&str; 6] = ["xy", "xz", "xt", "yz", "yt", "zt"];
        format!("{}{PLANE}{}_{}", self.name, index / 6, PAIRS[index % 6])
    }
}
