//! Weighted sums over tokens, shared by equations 3 to 8.

use shaders::arrays::rows::{cosine_distance, squared_norm};
use shaders::arrays::totals::total;
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Var};

use super::weights::directed;
use crate::method::Step;

/// Lower bound of the norms in a cosine.
const MIN_NORM: f64 = 1e-6;

/// A semantic loss in a step that evaluates it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Term {
    /// The name of the loss.
    pub name: &'static str,
    /// The loss whose unit it has; the losses at one instant have their own.
    pub unit: &'static str,
    /// The weight in this unit, including the ramp and the interval.
    pub share: f64,
    /// The weight of the angle relative to that of the distance.
    pub angle: f64,
}

/// Adds Σ wₙ‖aₙ − bₙ‖² to the loss.
pub(crate) fn add_distance<T: Real>(step: &mut Step<'_, T>, term: Term, [a, b]: [Var; 2], weights: Var) {
    let difference = sub(step.tape, a, b);
    let squared = squared_norm(step.tape, difference);
    add_sum(step, term, 1.0, squared, weights);
}

/// Adds angle · Σ wₙ(1 − cos(aₙ, bₙ)) to the loss, over rows in which both are at least `min_norm` long. The direction of
/// shorter vectors is noise, and the gradient of its angle explodes.
pub(crate) fn add_angle<T: Real>(step: &mut Step<'_, T>, term: Term, [a, b]: [Var; 2], weights: Var, min_norm: f64) {
    let weights = directed(step.tape, weights, [a, b], min_norm);
    let distance = cosine_distance(step.tape, a, b, MIN_NORM);
    add_sum(step, term, term.angle, distance, weights);
}

/// Adds weight · Σ wₙxₙ for x and w [N, 1], averaged over the views of the step.
fn add_sum<T: Real>(step: &mut Step<'_, T>, term: Term, weight: f64, x: Var, weights: Var) {
    let weighted = mul(step.tape, x, weights);
    let value = total(step.tape, weighted);
    let weight = weight / step.views.len() as f64;
    match step.units.unit(term.unit) {
        Some(unit) => step.add_loss(term.name, term.share * unit * weight, value),
        None if term.unit == term.name => step.measure_unit(term.name, weight, value),
        None => (),
    }
}
