//! Nodes avoid acceleration and haste (equations 17 to 19).

use serde::{Deserialize, Serialize};
use shaders::losses::mean;
use shaders::pointwise::{add, magnitude, mul, scale, square, sub};
use shaders::quaternion;
use shaders::rows::row_sum;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::motion::NodeMotion;
use crate::method::Step;

/// The least length that motion is measured in, as a share of the scene's extent: nodes at rest have none.
const MIN_UNIT: f64 = 1e-4;

/// Weights, once lengths are measured by how far the nodes are from their canonical places, and times in frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhysicsSettings {
    /// λ_a, of acceleration.
    pub acceleration: f64,
    /// λ_s, of haste. It draws towards no motion, so it must be small.
    pub haste: f64,
    /// α, of turning within haste.
    pub turning: f64,
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self { acceleration: 1e-3, haste: 1e-4, turning: 0.1 }
    }
}

/// λ_a·mean ‖μ₊ − 2μ + μ₋‖² / u² + λ_s·(mean ‖μ₊ − μ‖₁ / u + α·mean ‖q₊ − q‖₁) over the nodes at three frames; u is the root
/// of the mean squared distance from the canonical places, held fixed.
pub fn add_losses<T: Real>(step: &mut Step<'_, T>, settings: &PhysicsSettings, frames: &[NodeMotion]) {
    let [before, now, after] = frames else { unreachable!("three frames") };
    let unit = unit_length(step.tape.value(now.translations), step.scene.extent);
    let tape = &mut *step.tape;
    let inverse = tape.detach_value(Tensor::scalar(T::from_f64(1.0 / unit)));

    let arriving = sub(tape, now.translations, before.translations);
    let leaving = sub(tape, after.translations, now.translations);
    let change = sub(tape, leaving, arriving);
    let squares = square(tape, change);
    let acceleration = mean_over_rows(tape, squares);
    let acceleration = mul(tape, acceleration, inverse);
    let acceleration = mul(tape, acceleration, inverse);

    let haste = magnitude(tape, leaving);
    let haste = mean_over_rows(tape, haste);
    let haste = mul(tape, haste, inverse);
    let next = quaternion::align(tape, after.rotations, now.rotations);
    let turn = sub(tape, next, now.rotations);
    let turn = magnitude(tape, turn);
    let turn = mean_over_rows(tape, turn);
    let turn = scale(tape, turn, settings.turning);
    let haste = add(tape, haste, turn);

    step.add_loss("acceleration", settings.acceleration, acceleration);
    step.add_loss("haste", settings.haste, haste);
}

/// The mean over rows of the sum of each.
fn mean_over_rows<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    let sums = row_sum(tape, x);
    mean(tape, sums)
}

fn unit_length<T: Real>(translations: &Tensor<T>, extent: f64) -> f64 {
    let squared: f64 = translations.as_slice().iter().map(|value| value.to_f64().powi(2)).sum();
    (squared / translations.rows() as f64).sqrt().max(MIN_UNIT * extent)
}
