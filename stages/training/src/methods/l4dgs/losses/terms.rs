//! Sums over weighted tokens: the terms that equations 3 to 8 have in common.

use shaders::pointwise::{mul, sub};
use shaders::rows::{cosine_distance, reshape, row_dot, row_sum, scale_rows, squared_norm};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::method::Step;

/// Shorter vectors count as this long in a cosine.
const MIN_NORM: f64 = 1e-6;

/// How much attention every token receives: the mean over the rows of the attention map.
pub fn focus<T: Real>(probabilities: &Tensor<T>) -> Vec<f64> {
    let count = probabilities.rows();
    let mut received = vec![0.0; count];
    for row in 0..count {
        received.iter_mut().zip(probabilities.row(row)).for_each(|(sum, p)| *sum += p.to_f64() / count as f64);
    }
    received
}

/// Weights of the valid tokens that sum to 1, zero elsewhere; none if no valid token has any.
pub fn normalized(focus: &[f64], valid: impl Fn(usize) -> bool) -> Option<Vec<f64>> {
    let masked: Vec<f64> = focus.iter().enumerate().map(|(at, &weight)| if valid(at) { weight } else { 0.0 }).collect();
    let sum: f64 = masked.iter().sum();
    (sum > 0.0).then(|| masked.into_iter().map(|weight| weight / sum).collect())
}

/// Weights for terms that also punish true motion: full from the uniform weight on, falling with the square below.
pub fn still(weights: &[f64]) -> Vec<f64> {
    let valid = weights.iter().filter(|weight| **weight > 0.0).count() as f64;
    weights.iter().map(|weight| weight * (weight * valid).min(1.0)).collect()
}

/// Which cells [tokens, cells] count, as zeros and ones; and which tokens have such a cell.
pub struct CellMask<T: Real> {
    ones: Tensor<T>,
}

impl<T: Real> CellMask<T> {
    pub fn new(tokens: usize, a: &[bool], b: &[bool]) -> Self {
        let ones = a.iter().zip(b).map(|(&a, &b)| if a && b { T::ONE } else { T::ZERO }).collect();
        Self { ones: Tensor::from_vec([tokens, a.len() / tokens], ones) }
    }

    /// Whether any cell of a token counts.
    pub fn any(&self, token: usize) -> bool {
        self.ones.row(token).iter().any(|&one| one > T::ZERO)
    }

    /// x [tokens, cells] where it counts, else 0.
    pub fn masked(&self, tape: &mut Tape<T>, x: Var) -> Var {
        let ones = tape.constant(self.ones.clone());
        mul(tape, x, ones)
    }

    /// Masked rows less the mean over what counts in them.
    pub fn centered(&self, tape: &mut Tape<T>, masked: Var) -> Var {
        let tokens = self.ones.rows();
        let share = |token: usize| T::ONE / self.ones.row(token).iter().copied().sum::<T>().max(T::ONE);
        let shares = tape.constant(Tensor::from_vec([tokens, 1], (0..tokens).map(share).collect()));
        let sums = row_sum(tape, masked);
        let means = mul(tape, sums, shares);
        let ones = tape.constant(self.ones.clone());
        let mean_of_cells = scale_rows(tape, ones, means);
        sub(tape, masked, mean_of_cells)
    }
}

/// Adds weight · Σ wₙ‖aₙ − bₙ‖².
pub fn add_distance<T: Real>(
    step: &mut Step<'_, T>,
    name: &'static str,
    weight: f64,
    [a, b]: [Var; 2],
    weights: &[f64],
) {
    let difference = sub(step.tape, a, b);
    let squared = squared_norm(step.tape, difference);
    let value = weighted_sum(step.tape, squared, weights);
    step.add_loss(name, weight, value);
}

/// Adds weight · Σ wₙ(1 − cos(aₙ, bₙ)) over the rows in which both are at least `min_norm` long: below that a direction
/// is noise, and the gradient of its angle explodes.
pub fn add_angle<T: Real>(
    step: &mut Step<'_, T>,
    name: &'static str,
    weight: f64,
    [a, b]: [Var; 2],
    weights: &[f64],
    min_norm: f64,
) {
    let length = |row: &[T]| row.iter().map(|value| value.to_f64().powi(2)).sum::<f64>().sqrt();
    let directed = |row: usize| [a, b].iter().all(|&var| length(step.tape.value(var).row(row)) >= min_norm);
    let weights: Vec<f64> =
        weights.iter().enumerate().map(|(row, &weight)| if directed(row) { weight } else { 0.0 }).collect();
    let distance = cosine_distance(step.tape, a, b, MIN_NORM);
    let value = weighted_sum(step.tape, distance, &weights);
    step.add_loss(name, weight, value);
}

/// Σ wₙxₙ for x [N, 1].
fn weighted_sum<T: Real>(tape: &mut Tape<T>, x: Var, weights: &[f64]) -> Var {
    let as_row = reshape(tape, x, [1, weights.len()]);
    let weights = weights.iter().map(|&weight| T::from_f64(weight)).collect();
    let weights = tape.constant(Tensor::from_vec([1, tape.value(as_row).len()], weights));
    row_dot(tape, as_row, weights)
}
