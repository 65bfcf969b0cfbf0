//! Penalties on the acceleration and the speed of nodes (equations 17 to 19).

use serde::{Deserialize, Serialize};
use shaders::arrays::rows::row_sum;
use shaders::arrays::totals::mean;
use shaders::geometry::quaternion;
use shaders::pointwise::{add, magnitude, scale, square, sub};
use shaders::tape::{Real, Tape, Var};

use super::node_motion::NodeMotion;
use crate::method::Step;

/// Weights of the physics losses, for lengths per frame in scene extents per duration of the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct PhysicsSettings {
    /// λ_a, the weight of acceleration.
    pub acceleration: f64,
    /// λ_s, weight of the speed penalty. It pulls towards no motion, so it must be small.
    pub speed_penalty: f64,
    /// α, the share of the angular speed in the speed penalty.
    pub turning: f64,
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self { acceleration: 0.1, speed_penalty: 1e-3, turning: 0.1 }
    }
}

/// λ_a·mean ‖μ₊ − 2μ + μ₋‖² / u² + λ_s·(mean ‖μ₊ − μ‖₁ / u + α·mean ‖q₊ − q‖₁) over the nodes at three frames. The unit
/// u is the displacement per frame of an object that crosses the scene's extent in the duration of the capture. A unit
/// derived from the motion itself would penalise small motion more than large motion.
pub(crate) fn add_losses<T: Real>(step: &mut Step<'_, T>, settings: &PhysicsSettings, frames: &[NodeMotion]) {
    let [before, now, after] = frames else { unreachable!("three frames") };
    let per_unit = 1.0 / (step.scene.extent * step.scene.training_interval());
    let tape = &mut *step.tape;

    let arriving = sub(tape, now.translations, before.translations);
    let leaving = sub(tape, after.translations, now.translations);
    let change = sub(tape, leaving, arriving);
    let squares = square(tape, change);
    let acceleration = mean_over_rows(tape, squares);
    let acceleration = scale(tape, acceleration, per_unit * per_unit);

    let speed = magnitude(tape, leaving);
    let speed = mean_over_rows(tape, speed);
    let speed = scale(tape, speed, per_unit);
    let next = quaternion::align(tape, after.rotations, now.rotations);
    let turn = sub(tape, next, now.rotations);
    let turn = magnitude(tape, turn);
    let turn = mean_over_rows(tape, turn);
    let turn = scale(tape, turn, settings.turning);
    let speed = add(tape, speed, turn);

    let per_view = 1.0 / step.views.len() as f64;
    let weights = [settings.acceleration, settings.speed_penalty].map(|weight| weight * per_view);
    step.add_losses(&[("acceleration", weights[0], acceleration), ("speed_penalty", weights[1], speed)]);
}

/// Sums every row and returns the mean over the rows.
fn mean_over_rows<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    let sums = row_sum(tape, x);
    mean(tape, sums)
}
