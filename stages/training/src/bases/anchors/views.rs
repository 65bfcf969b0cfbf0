//! The networks that turn an anchor's feature and the direction it is seen from into Gaussians (Lu et al. 2024, section
//! 3.2).

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use shaders::linear::Activation;
use shaders::neural_gaussians::{AnchorVars, NeuralGaussians, neural_gaussians};
use shaders::pointwise::{hyperbolic_tangent, sigmoid, sub};
use shaders::rows::{concat_columns, normalize, repeat_row};
use shaders::splat::{PinholeCamera, ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::{ANCHORS, AnchorSettings, Anchors};
use crate::bases::layers::{FirstWeights, apply_layer, insert_layer};
use crate::method::SplatRows;
use crate::state::{ModelState, Variables};

/// The networks' tensors are called `views.…`.
pub(super) const VIEWS: &str = "views";
/// An anchor this near the camera, scene units, is seen from no direction rather than from an infinite one.
const MIN_DISTANCE: f64 = 1e-8;

/// Adds the three networks: F + 3 → width → outputs.
pub fn insert_view_networks<T: Real>(state: &mut ModelState<T>, settings: &AnchorSettings, random: &mut ChaCha8Rng) {
    let AnchorSettings { features, offsets, width, .. } = *settings;
    for (network, outputs) in [("opacity", offsets), ("shape", 7 * offsets), ("color", 3 * offsets)] {
        let [inner, outer] = layers(network);
        insert_layer(state, &inner, features + 3, width, FirstWeights::Xavier, random);
        insert_layer(state, &outer, width, outputs, FirstWeights::Xavier, random);
    }
}

/// The Gaussians of one view, and which of the N·K they are.
#[derive(Clone, Debug)]
pub struct SpawnedGaussians {
    /// What is drawn.
    pub splats: SplatVars,
    /// [M]: anchor·K + k.
    pub slots: Arc<Vec<u32>>,
    /// [N] whether the camera looks at the anchor.
    in_view: Vec<bool>,
    per_anchor: usize,
}

impl SpawnedGaussians {
    /// For [`Step::render_rows`](crate::method::Step::render_rows).
    pub fn rows(&self) -> SplatRows {
        let looked_at = self.in_view.iter().flat_map(|&seen| std::iter::repeat_n(seen, self.per_anchor)).collect();
        SplatRows { population: ANCHORS, row_of_splat: self.slots.clone(), looked_at }
    }
}

/// The Gaussians with positive opacity of anchors as a camera sees them.
pub fn spawn<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    anchors: &Anchors,
    camera: &PinholeCamera,
) -> SpawnedGaussians {
    let count = tape.value(anchors.positions).rows();
    let camera_position = tape.constant(Tensor::from_vec([3], camera.position_world().map(T::from_f64).to_vec()));
    let camera_position = repeat_row(tape, camera_position, count);
    let from_camera = sub(tape, anchors.positions, camera_position);
    let direction = normalize(tape, from_camera, MIN_DISTANCE);
    let seen = concat_columns(tape, &[anchors.features, direction]);

    let opacities = network(tape, model, "opacity", seen);
    let opacities = hyperbolic_tangent(tape, opacities);
    let shapes = network(tape, model, "shape", seen);
    let colors = network(tape, model, "color", seen);
    let colors = sigmoid(tape, colors);
    let Anchors { positions, log_scales, offsets, .. } = *anchors;
    let per_anchor = tape.value(opacities).row_len();
    let found = neural_gaussians(tape, &AnchorVars { positions, log_scales, offsets, opacities, shapes, colors });
    let NeuralGaussians { positions, log_scales, rotations, opacity_logits, sh, slots } = found;
    let shape = ShapeVars::ScaleRotation { log_scales, rotations };
    let splats = SplatVars { positions, shape, opacity_logits, sh };
    SpawnedGaussians { splats, slots, in_view: in_view(tape.value(anchors.positions), camera), per_anchor }
}

/// Whether a camera's image shows the place of each anchor, in front of it.
fn in_view<T: Real>(positions: &Tensor<T>, camera: &PinholeCamera) -> Vec<bool> {
    let is_seen = |row: usize| {
        let world = positions.row(row);
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let rotation = camera.rotation[axis];
            (0..3).map(|at| rotation[at] * world[at].to_f64()).sum::<f64>() + camera.translation[axis]
        });
        let [u, v] = [camera.focal[0] * x / z + camera.center[0], camera.focal[1] * y / z + camera.center[1]];
        z > 0.0 && (0.0..camera.width as f64).contains(&u) && (0.0..camera.height as f64).contains(&v)
    };
    (0..positions.rows()).map(is_seen).collect()
}

fn network<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, x: Var) -> Var {
    let [inner, outer] = layers(name);
    let hidden = apply_layer(tape, model, &inner, x, Activation::Relu);
    apply_layer(tape, model, &outer, hidden, Activation::Identity)
}

fn layers(network: &str) -> [String; 2] {
    [0, 1].map(|layer| format!("{VIEWS}.{network}.{layer}"))
}
