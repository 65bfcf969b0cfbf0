//! Gaussians in space and time (Yang et al. 2024); a render at one time shows a slice of them.
//!
//! Their unit of time is the method's: rotations in four dimensions and initial lifetimes depend on it. Rotations mix
//! lengths and times, so that unit is multiplied by [`SceneFacts::unit_world`](crate::data::SceneFacts::unit_world).
//!
//! | tensor | shape | stored as |
//! |---|---|---|
//! | `positions`, `times` | [N, 3], [N, 1] | scene units; units of time |
//! | `log_scales_time` | [N, 1] | logarithm of the standard deviation along the fourth axis |
//! | `rotations_left`, `rotations_right` | [N, 4] | quaternions of the rotation in four dimensions |
//! | `opacity_logits` | [N, 1] | at their own time, before the logistic function |
//!
//! Spatial scales and colours differ between methods.

mod moving;

use shaders::arrays::totals::total;
use shaders::rasteriser::slicing4d::{self, Gaussians4dVars, SlicedVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::layers::uniform;
use crate::data::Streams;
use crate::method::Step;
use crate::model::{ModelState, Variables};

pub(crate) use moving::{Moving, insert_moving};

/// Gaussians with a smaller share of their opacity left are hidden (published code); 2.45 standard deviations.
pub(crate) const MIN_SHARE: f64 = 0.05;

/// Margin of the initial times beyond the clip, as a share of the clip (published code).
const TIME_MARGIN: f64 = 0.1;
/// The initial variance along time per length of the clip (published code): the standard deviation is √(0.2·L) units of
/// time for a clip of L units.
const INITIAL_VARIANCE_PER_LENGTH: f64 = 0.2;

/// The parameters of a population, with the logarithms of its spatial scales [N, 3].
pub(crate) fn parameters(model: &Variables, population: &str, log_scales: Var) -> Gaussians4dVars {
    let var = |attribute: &str| model.get(&format!("{population}.{attribute}"));
    Gaussians4dVars {
        log_scales,
        log_scales_time: var("log_scales_time"),
        rotations_left: var("rotations_left"),
        rotations_right: var("rotations_right"),
        times: var("times"),
        opacity_logits: var("opacity_logits"),
    }
}

/// Slices a population at a time in its unit; Gaussians with less than [`MIN_SHARE`] of their opacity are hidden.
pub(crate) fn slice<T: Real>(tape: &mut Tape<T>, parameters: &Gaussians4dVars, time: f64) -> SlicedVars {
    slicing4d::slice(tape, parameters, time, MIN_SHARE)
}

/// The velocities Σ₁₄/Σ₄₄ [N, 3] of all Gaussians, scene units per unit of time, whereas a slice has zeros for those
/// absent at its time. Times and opacities get no gradient.
pub(crate) fn velocities<T: Real>(tape: &mut Tape<T>, parameters: &Gaussians4dVars) -> Var {
    let count = tape.value(parameters.times).len();
    // Every Gaussian is present at its own time.
    let times = tape.constant(Tensor::zeros([count, 1]));
    slice(tape, &Gaussians4dVars { times, ..*parameters }, 0.0).velocities
}

/// Adds `times`, `log_scales_time`, `rotations_left` and `rotations_right` to a population of `count` Gaussians: times
/// uniform over a clip of `length`·`unit_world` and a margin ([`TIME_MARGIN`]), the variance
/// 0.2·`length`·`unit_world`², no motion.
pub(crate) fn insert_time<T: Real>(
    state: &mut ModelState<T>,
    population: &str,
    count: usize,
    length: f64,
    unit_world: f64,
    random: Streams,
) {
    let identity = [T::ONE, T::ZERO, T::ZERO, T::ZERO].repeat(count);
    let mut times = random.tensor(&format!("{population}.times"));
    let mut insert = |attribute: &str, tensor: Tensor<T>| state.insert(format!("{population}.{attribute}"), tensor);
    let [first, last] = [-TIME_MARGIN * length, (1.0 + TIME_MARGIN) * length];
    insert("times", uniform(&[count, 1], first * unit_world, last * unit_world, &mut times));
    let variance = INITIAL_VARIANCE_PER_LENGTH * length;
    insert("log_scales_time", Tensor::full([count, 1], T::from_f64(0.5 * variance.ln() + unit_world.ln())));
    insert("rotations_left", Tensor::from_vec([count, 4], identity.clone()));
    insert("rotations_right", Tensor::from_vec([count, 4], identity));
}

/// Counts the Gaussians that a slice hides as skipped work `what`.
pub(crate) fn count_skipped<T: Real>(step: &mut Step<'_, T>, what: &'static str, sliced: &SlicedVars) {
    let count = step.tape.value(sliced.present).len();
    let present = total(step.tape, sliced.present);
    step.count_skipped_deferred(what, present, count);
}
