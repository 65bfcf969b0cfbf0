//! Gaussians in space and time (Yang et al. 2024), of which every instant shows a slice.
//!
//! | tensor | shape | stored as |
//! |---|---|---|
//! | `positions`, `times` | [N, 3], [N, 1] | scene units; share of the clip |
//! | `log_scales_time` | [N, 1] | logarithm of the standard deviation along the fourth axis |
//! | `rotations_left`, `rotations_right` | [N, 4] | quaternions of the rotation in four dimensions |
//! | `opacity_logits` | [N, 1] | at their own time, before the logistic function |
//!
//! Spatial scales and colours differ between methods.

use shaders::rows::RowIndex;
use shaders::slicing4d::{self, Gaussians4dVars, SlicedVars};
use shaders::tape::{Real, Tape, Var};

use crate::state::Variables;

/// Gaussians of which a smaller share of the opacity is left are not drawn (published code): 2.45 standard deviations.
pub const LEAST_SHARE: f64 = 0.05;

/// The Gaussians that an instant shows.
pub struct Slice {
    /// Which of the population they are.
    pub rows: RowIndex,
    /// What they are at the instant.
    pub sliced: SlicedVars,
}

/// The parameters of a population, with the logarithms of its spatial scales [N, 3].
pub fn parameters(model: &Variables, population: &str, log_scales: Var) -> Gaussians4dVars {
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

/// Cuts a population at a time in [0, 1]; Gaussians with less than [`LEAST_SHARE`] are left out.
pub fn slice<T: Real>(tape: &mut Tape<T>, parameters: &Gaussians4dVars, time: f64) -> Slice {
    let rows = slicing4d::rows_at(tape, parameters, time, LEAST_SHARE);
    let rows = RowIndex::new(rows, tape.value(parameters.times).len());
    let sliced = slicing4d::slice(tape, parameters, time, &rows);
    Slice { rows, sliced }
}
