//! Coherence of neighbours in motion and in time (KineticGS equation 12).

use shaders::arrays::rows::{divide_rows, reshape, squared_norm};
use shaders::arrays::totals::mean;
use shaders::pointwise::sub;
use shaders::tape::{Real, Tape, Var};

use super::neighbors::Pairs;
use super::particles::Particles;

/// Lower bound of the unit of displacements, as a share of the scene's extent.
const LEAST_UNIT: f64 = 1e-3;

/// Mean of ‖xᵢ − xⱼ‖² over pairs (i, j) for x [P, C]; shape [1].
fn mean_squared_difference<T: Real>(tape: &mut Tape<T>, pairs: &Pairs, x: Var) -> Var {
    let [first, second] = pairs.both(tape, x);
    let difference = sub(tape, first, second);
    let squared = squared_norm(tape, difference);
    mean(tape, squared)
}

/// Mean squared difference of displacements [P, 3] between neighbours, in units of the root mean square displacement.
pub(crate) fn displacement_incoherence<T: Real>(
    tape: &mut Tape<T>,
    displacements: Var,
    pairs: &Pairs,
    extent: f64,
) -> Var {
    let difference = mean_squared_difference(tape, pairs, displacements);
    let lengths = tape.detach(displacements);
    let lengths = squared_norm(tape, lengths);
    let squared_unit = mean(tape, lengths);
    let value = divide_rows(tape, difference, squared_unit, (LEAST_UNIT * extent).powi(2));
    reshape(tape, value, [1])
}

/// Mean squared difference of window centres between neighbours, in shares of the clip; `None` without windows.
pub(crate) fn window_incoherence<T: Real>(
    tape: &mut Tape<T>,
    particles: &Particles<'_, T>,
    pairs: &Pairs,
) -> Option<Var> {
    Some(mean_squared_difference(tape, pairs, particles.windows?.centers))
}
