//! The distance of the chain's predictions from the states that they predict.

use shaders::arrays::rows::squared_norm;
use shaders::arrays::totals::mean;
use shaders::geometry::quaternion;
use shaders::pointwise::{add, scale, sub};
use shaders::tape::{Real, Tape, Var};

use super::node_motion::Predictions;
use crate::data::SceneFacts;

/// mean ‖Δμ̂ − Δμ‖² / u² + mean ‖Δq̂ − Δq‖² / Δt² over nodes and times, shape `[1]`, with Δμ̂, Δq̂ predicted by the chain and
/// Δμ, Δq of the direct branch, which receives no gradient. The units are those of the chain's outputs: u is the
/// displacement per frame of a node that crosses the scene's extent in the duration of the capture, Δt a frame's share of
/// that duration.
///
/// The paper trains the chain by images alone. An image shows only the share λ of a predicted step, a fraction of a
/// pixel, so the chain would hardly learn.
pub(crate) fn loss<T: Real>(tape: &mut Tape<T>, predictions: &Predictions, scene: &SceneFacts) -> Var {
    let Predictions { direct, chained } = predictions;
    let [translations, rotations] = [direct.translations, direct.rotations].map(|var| tape.detach(var));
    let aligned = quaternion::align(tape, chained.rotations, rotations);
    let per_frame = 1.0 / scene.training_interval();
    let shift = mean_square(tape, chained.translations, translations, per_frame / scene.extent);
    let turn = mean_square(tape, aligned, rotations, per_frame);
    add(tape, shift, turn)
}

/// The mean over the rows of ‖factor·(a − b)‖².
fn mean_square<T: Real>(tape: &mut Tape<T>, a: Var, b: Var, factor: f64) -> Var {
    let difference = sub(tape, a, b);
    let scaled = scale(tape, difference, factor);
    let squares = squared_norm(tape, scaled);
    mean(tape, squares)
}
