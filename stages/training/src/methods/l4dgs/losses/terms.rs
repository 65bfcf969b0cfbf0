//! Weighted sums over tokens, shared by equations 3 to 8.

use shaders::arrays::rows::{cosine_distance, squared_norm};
use shaders::arrays::totals::total;
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Var};

use super::weights::directed;
use crate::method::Step;

/// Lower bound of the norms in a cosine.
const MIN_NORM: f64 = 1e-6;

/// Adds weight · Σ wₙ‖aₙ − bₙ‖².
pub(crate) fn add_distance<T: Real>(
    step: &mut Step<'_, T>,
    name: &'static str,
    weight: f64,
    [a, b]: [Var; 2],
    weights: Var,
) {
    let difference = sub(step.tape, a, b);
    let squared = squared_norm(step.tape, difference);
    add_sum(step, name, weight, squared, weights);
}

/// Adds weight · Σ wₙ(1 − cos(aₙ, bₙ)) over rows in which both are at least `min_norm` long. The direction of shorter
/// vectors is noise, and the gradient of its angle explodes.
pub(crate) fn add_angle<T: Real>(
    step: &mut Step<'_, T>,
    name: &'static str,
    weight: f64,
    [a, b]: [Var; 2],
    weights: Var,
    min_norm: f64,
) {
    let weights = directed(step.tape, weights, [a, b], min_norm);
    let distance = cosine_distance(step.tape, a, b, MIN_NORM);
    add_sum(step, name, weight, distance, weights);
}

/// Adds weight · Σ wₙxₙ for x and w [N, 1].
fn add_sum<T: Real>(step: &mut Step<'_, T>, name: &'static str, weight: f64, x: Var, weights: Var) {
    let weighted = mul(step.tape, x, weights);
    let value = total(step.tape, weighted);
    step.add_loss(name, weight, value);
}
