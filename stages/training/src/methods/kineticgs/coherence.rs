//! Coherence of neighbours in motion and in time (KineticGS equation 12).

use shaders::arrays::rows::{divide_rows, reshape, squared_norm};
use shaders::arrays::totals::{mean, weighted_mean};
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Tape, Var};

use super::neighbors::Pairs;
use super::particles::{Moved, Particles};

/// Lower bound of the unit of displacements, as a share of the scene's extent.
const LEAST_UNIT: f64 = 1e-3;

/// Mean of ‖xᵢ − xⱼ‖² over pairs (i, j) for x [P, C], restricted to pairs with a mask [P, 1] of 1 on both sides; shape
/// [1].
fn mean_squared_difference<T: Real>(tape: &mut Tape<T>, pairs: &Pairs, x: Var, mask: Option<Var>) -> Var {
    let [first, second] = pairs.both(tape, x);
    let difference = sub(tape, first, second);
    let squared = squared_norm(tape, difference);
    let mask = mask.map(|mask| {
        let [first, second] = pairs.both(tape, mask);
        mul(tape, first, second)
    });
    mean_where(tape, squared, mask)
}

/// Mean of x [N, 1] over rows with a mask [N, 1] of 1; shape [1].
fn mean_where<T: Real>(tape: &mut Tape<T>, x: Var, mask: Option<Var>) -> Var {
    match mask {
        None => mean(tape, x),
        Some(mask) => weighted_mean(tape, x, mask),
    }
}

/// Mean squared difference of displacements between active neighbours, in units of the root mean square displacement;
/// `None` if the host knows that no particle is active.
pub(crate) fn displacement_incoherence<T: Real>(
    tape: &mut Tape<T>,
    moved: &Moved,
    pairs: &Pairs,
    extent: f64,
) -> Option<Var> {
    let displacements = moved.displacements?;
    let difference = mean_squared_difference(tape, pairs, displacements, moved.active);
    let lengths = tape.detach(displacements);
    let lengths = squared_norm(tape, lengths);
    let squared_unit = mean_where(tape, lengths, moved.active);
    let value = divide_rows(tape, difference, squared_unit, (LEAST_UNIT * extent).powi(2));
    Some(reshape(tape, value, [1]))
}

/// Mean squared difference of window centres between neighbours, in shares of the clip; `None` without windows.
pub(crate) fn window_incoherence<T: Real>(tape: &mut Tape<T>, particles: &Particles<T>, pairs: &Pairs) -> Option<Var> {
    Some(mean_squared_difference(tape, pairs, particles.windows?.centers, None))
}
