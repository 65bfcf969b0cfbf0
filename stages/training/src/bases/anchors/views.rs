//! The networks that map an anchor's feature and its viewing direction to Gaussians (Lu et al. 2024, section 3.2).

use std::sync::Arc;

use shaders::arrays::rows::{concat_columns, normalize, repeat_row, row_sum, scale_rows};
use shaders::geometry::camera::PinholeCamera;
use shaders::geometry::point_lookup::in_view;
use shaders::networks::linear::Activation;
use shaders::pointwise::{hyperbolic_tangent, mul, relu, sigmoid, sub};
use shaders::rasteriser::neural_gaussians::{AnchorVars, NeuralGaussians, neural_gaussians};
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::{ANCHORS, AnchorSettings, Anchors};
use crate::bases::layers::{FirstWeights, apply_layer, insert_layer};
use crate::data::Streams;
use crate::method::{ParentVars, SplatRows};
use crate::model::{ModelState, Variables};

/// Prefix of the networks' tensors.
pub(super) const VIEWS: &str = "views";
/// Minimum distance in the viewing direction's denominator, scene units: a nearer anchor has no direction.
const MIN_DISTANCE: f64 = 1e-8;

/// Adds the three networks: F + 3 → width → outputs, or F → … without the viewing direction.
pub(crate) fn insert_view_networks<T: Real>(
    state: &mut ModelState<T>,
    settings: &AnchorSettings,
    view_direction: bool,
    random: Streams,
) {
    let AnchorSettings { features, offsets, width, .. } = *settings;
    let inputs = if view_direction { features + 3 } else { features };
    for (network, outputs) in [("opacity", offsets), ("shape", 7 * offsets), ("color", 3 * offsets)] {
        let [inner, outer] = layers(network);
        insert_layer(state, &inner, inputs, width, FirstWeights::FanIn, random);
        insert_layer(state, &outer, width, outputs, FirstWeights::FanIn, random);
    }
}

/// The Gaussians of one view, with their slots among the N·K possible ones.
#[derive(Clone, Debug)]
pub(crate) struct SpawnedGaussians {
    /// The splats.
    pub splats: SplatVars,
    /// [M] slot anchor·K + k of each of the first M splats; `None`: all slots in order (see [`neural_gaussians`]).
    pub slots: Option<Arc<Vec<u32>>>,
    /// Number of splats that follow these: the subject's Gaussians.
    pub(super) subject_count: usize,
    /// Number of slots, N·K.
    pub(super) count: usize,
    /// The N anchors.
    pub(super) parents: ParentVars,
}

impl SpawnedGaussians {
    /// The population rows of the splats, for [`Step::render`](crate::method::Step::render).
    pub(crate) fn rows(&self) -> SplatRows {
        let (count, row_of_splat, parents) = (self.count, self.slots.clone(), self.parents);
        SplatRows { population: ANCHORS, count, row_of_splat, parents }
    }

    /// The rows of all splats for [`Base::rows`](crate::method::Base::rows): the slots, then the subject's Gaussians.
    pub(crate) fn rows_at_moment(&self) -> Option<Vec<u32>> {
        let subject = self.count as u32..(self.count + self.subject_count) as u32;
        Some(self.slots.as_ref()?.iter().copied().chain(subject).collect())
    }
}

/// The Gaussians that anchors spawn for a camera. An anchor with a 0 in `drawn` [N, 1] spawns none, counts as outside
/// the view, and receives no gradient; `None` draws all.
pub(crate) fn spawn<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    anchors: &Anchors,
    drawn: Option<Var>,
    camera: &PinholeCamera,
) -> SpawnedGaussians {
    let seen = inputs(tape, model, anchors, camera);
    let opacities = network(tape, model, "opacity", seen);
    let opacities = hyperbolic_tangent(tape, opacities);
    let opacities = only(tape, opacities, drawn);
    let shapes = network(tape, model, "shape", seen);
    let colors = network(tape, model, "color", seen);
    let colors = sigmoid(tape, colors);
    let Anchors { positions, log_scales, offsets, .. } = *anchors;
    let mut parents = parents(tape, positions, opacities, camera);
    parents.in_view = only(tape, parents.in_view, drawn);
    let count = tape.value(opacities).len();
    let found = neural_gaussians(tape, &AnchorVars { positions, log_scales, offsets, opacities, shapes, colors });
    let NeuralGaussians { positions, log_scales, rotations, opacity_logits, sh, slots } = found;
    let shape = ShapeVars::ScaleRotation { log_scales, rotations };
    let splats = SplatVars { positions, shape, opacity_logits, sh };
    SpawnedGaussians { splats, slots, subject_count: 0, count, parents }
}

/// The input of the networks: features, and the viewing direction if the networks are built for it.
fn inputs<T: Real>(tape: &mut Tape<T>, model: &Variables, anchors: &Anchors, camera: &PinholeCamera) -> Var {
    let columns = tape.value(model.get(&format!("{}.weight", layers("opacity")[0]))).row_len();
    if columns == tape.value(anchors.features).row_len() {
        return anchors.features;
    }
    let count = tape.value(anchors.positions).rows();
    let camera_position = tape.constant(Tensor::from_vec([3], camera.position_world().map(T::from_f64).to_vec()));
    let camera_position = repeat_row(tape, camera_position, count);
    let from_camera = sub(tape, anchors.positions, camera_position);
    let direction = normalize(tape, from_camera, MIN_DISTANCE);
    concat_columns(tape, &[anchors.features, direction])
}

/// x [N, …] times `drawn` [N, 1]; `None` leaves x as it is.
fn only<T: Real>(tape: &mut Tape<T>, x: Var, drawn: Option<Var>) -> Var {
    drawn.map_or(x, |drawn| scale_rows(tape, x, drawn))
}

/// Values of anchors at `positions` [N, 3] for a camera, given the `opacities` [N, K] of their networks; 0 for anchors out of view.
fn parents<T: Real>(tape: &mut Tape<T>, positions: Var, opacities: Var, camera: &PinholeCamera) -> ParentVars {
    // Gaussians with an opacity at or below 0 are not drawn.
    let opacities = relu(tape, opacities);
    let opacity = row_sum(tape, opacities);
    let in_view = in_view(tape, positions, camera);
    ParentVars { in_view, opacity: mul(tape, opacity, in_view) }
}

fn network<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, x: Var) -> Var {
    let [inner, outer] = layers(name);
    let hidden = apply_layer(tape, model, &inner, x, Activation::Relu);
    apply_layer(tape, model, &outer, hidden, Activation::Identity)
}

fn layers(network: &str) -> [String; 2] {
    [0, 1].map(|layer| format!("{VIEWS}.{network}.{layer}"))
}
