//! The softmax of one row and its gradient.

use crate::tape::Real;

/// Replaces scores by e^(score − max) / Σ e^(score − max). An empty row stays empty: the caller removes
/// masked scores instead of writing −∞, whose differences would be NaN.
pub(super) fn softmax<T: Real>(scores: &mut [T]) {
    let largest = scores.iter().fold(scores.first().copied().unwrap_or(T::ZERO), |largest, &score| largest.max(score));
    scores.iter_mut().for_each(|score| *score = (*score - largest).exp());
    let sum: T = scores.iter().copied().sum();
    scores.iter_mut().for_each(|score| *score /= sum);
}

/// Replaces the gradient of the probabilities p by that of the scores: p·(dp − Σ p·dp).
pub(crate) fn softmax_backward<T: Real>(probabilities: &[T], gradient: &mut [T]) {
    let mean: T = probabilities.iter().zip(&*gradient).map(|(&p, &dp)| p * dp).sum();
    gradient.iter_mut().zip(probabilities).for_each(|(gradient, &p)| *gradient = p * (*gradient - mean));
}
