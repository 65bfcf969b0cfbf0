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

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use shaders::rows::RowIndex;
use shaders::slicing4d::{self, Gaussians4dVars, SlicedVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::layers::uniform;
use crate::method::SplatRows;
use crate::state::{ModelState, Variables};

/// Gaussians of which a smaller share of the opacity is left are not drawn (published code): 2.45 standard deviations.
pub const LEAST_SHARE: f64 = 0.05;

/// How far beyond the clip the first times are drawn, as a share of it (published code).
const TIME_MARGIN: f64 = 0.1;
/// The first variance along time, as a share of the clip's squared length (published code).
const INITIAL_VARIANCE_TIME: f64 = 0.2;

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

/// The Gaussians of which at least [`LEAST_SHARE`] of the opacity is left at a time in [0, 1].
pub fn rows_at<T: Real>(tape: &Tape<T>, parameters: &Gaussians4dVars, time: f64) -> Vec<u32> {
    slicing4d::rows_at(tape, parameters, time, LEAST_SHARE)
}

/// Cuts a population at a time in [0, 1]; Gaussians with less than [`LEAST_SHARE`] are left out.
pub fn slice<T: Real>(tape: &mut Tape<T>, parameters: &Gaussians4dVars, time: f64) -> Slice {
    let rows = RowIndex::new(rows_at(tape, parameters, time), tape.value(parameters.times).len());
    let sliced = slicing4d::slice(tape, parameters, time, &rows);
    Slice { rows, sliced }
}

/// Adds `times`, `log_scales_time`, `rotations_left` and `rotations_right` to a population of `count` Gaussians: spread
/// over the clip, a fifth of it in variance, at rest.
pub fn insert_time<T: Real>(state: &mut ModelState<T>, population: &str, count: usize, random: &mut ChaCha8Rng) {
    let identity = [T::ONE, T::ZERO, T::ZERO, T::ZERO].repeat(count);
    let mut insert = |attribute: &str, tensor: Tensor<T>| state.insert(format!("{population}.{attribute}"), tensor);
    insert("times", uniform(&[count, 1], -TIME_MARGIN, 1.0 + TIME_MARGIN, random));
    insert("log_scales_time", Tensor::full([count, 1], T::from_f64(0.5 * INITIAL_VARIANCE_TIME.ln())));
    insert("rotations_left", Tensor::from_vec([count, 4], identity.clone()));
    insert("rotations_right", Tensor::from_vec([count, 4], identity));
}

/// The rows of a slice of `population`, for [`Step::render_rows`](crate::method::Step::render_rows).
pub fn rows_of(population: &'static str, rows: &RowIndex) -> SplatRows {
    let mut looked_at = vec![false; rows.rows()];
    rows.row_of_item().iter().for_each(|&row| looked_at[row as usize] = true);
    SplatRows { population, row_of_splat: Arc::new(rows.row_of_item().to_vec()), looked_at }
}
