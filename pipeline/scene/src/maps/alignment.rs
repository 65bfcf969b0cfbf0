//! Robust fit of a scale and a shift, e.g. of relative depth to known points.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::statistics::median;

/// Number of random minimal samples. If half of the samples are wrong, all trials fail with probability 10⁻¹⁸.
const TRIALS: usize = 150;
/// Largest error of an inlier, relative to its target.
const INLIER_TOLERANCE: f64 = 0.05;
/// Largest error of an inlier during refinement, in robust standard deviations (and within [`INLIER_TOLERANCE`]).
const MAX_DEVIATIONS: f64 = 2.5;
/// Minimum number of samples for a fit: fewer do not constrain two unknowns robustly.
pub const MIN_SAMPLES: usize = 8;
/// Minimum share of inliers among the samples; fits below it are rejected.
pub const MIN_INLIER_SHARE: f64 = 0.3;
/// Rounds of least squares on the inliers of the previous fit.
const REFINEMENTS: usize = 10;
/// Ratio of the median absolute deviation of normal noise to its standard deviation.
const MAD_OF_NORMAL: f64 = 0.6745;

/// The model `target ≈ scale · value + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Positive factor.
    pub scale: f64,
    /// Offset, in units of the target; 0 for a fit without a shift.
    pub shift: f64,
    /// Share of inliers among all samples, in [0, 1].
    pub inlier_share: f64,
}

impl Fit {
    /// Maps a value to the scale of the targets.
    pub fn apply(&self, value: f64) -> f64 {
        self.scale * value + self.shift
    }
}

/// Fits `target ≈ scale · value + shift` to pairs (value, positive target) with outliers: RANSAC (Fischler and Bolles
/// 1981), then least squares on the inliers.
///
/// `None` if there are fewer than [`MIN_SAMPLES`] samples, fewer inliers than [`MIN_INLIER_SHARE`], or no positive scale
/// that fits.
pub fn fit_scale_shift(samples: &[(f64, f64)]) -> Option<Fit> {
    fit(samples, true)
}

/// Fits `target ≈ scale · value` to pairs (value, positive target) with outliers; otherwise like [`fit_scale_shift`].
pub fn fit_scale(samples: &[(f64, f64)]) -> Option<Fit> {
    fit(samples, false)
}

/// RANSAC and refinement for both models.
fn fit(samples: &[(f64, f64)], with_shift: bool) -> Option<Fit> {
    if samples.len() < MIN_SAMPLES {
        return None;
    }
    // The seed depends on the samples alone, so that equal samples give equal fits.
    let mut random = ChaCha8Rng::seed_from_u64(samples.len() as u64);
    let mut candidate = || {
        let first = random.random_range(0..samples.len());
        let second = (first + random.random_range(1..samples.len())) % samples.len();
        let pair = if with_shift { vec![samples[first], samples[second]] } else { vec![samples[first]] };
        least_squares(&pair, with_shift)
    };
    let tolerance = |target: f64| INLIER_TOLERANCE * target.abs();
    let agreeing = |fit: &Fit| samples.iter().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).count();
    let candidates = (0..TRIALS).filter_map(|_| candidate()).map(|fit| (agreeing(&fit), fit));
    // On a tie, the first candidate wins.
    let best = candidates.reduce(|best, next| if next.0 > best.0 { next } else { best });
    let mut fit = best?.1;
    let mut inliers: Vec<_> =
        samples.iter().copied().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).collect();
    for _ in 0..REFINEMENTS {
        fit = least_squares(&inliers, with_shift)?;
        let spread = median(inliers.iter().map(|(x, y)| (fit.apply(*x) - y).abs()))? / MAD_OF_NORMAL;
        let agrees = |(x, y): &(f64, f64)| {
            let error = (fit.apply(*x) - y).abs();
            // Without noise the spread is 0: the slack keeps samples that are off by rounding.
            error <= tolerance(*y) && error <= MAX_DEVIATIONS * spread + 1e-9 * y.abs()
        };
        inliers = samples.iter().copied().filter(agrees).collect();
    }
    let agreeing = samples.iter().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).count();
    fit.inlier_share = agreeing as f64 / samples.len() as f64;
    (fit.inlier_share >= MIN_INLIER_SHARE).then_some(fit)
}

/// The least-squares line, through the origin unless `with_shift`; `None` if the values determine no line with a
/// positive slope.
fn least_squares(samples: &[(f64, f64)], with_shift: bool) -> Option<Fit> {
    let count = samples.len() as f64;
    let (mean_x, mean_y) = if with_shift {
        let sum = samples.iter().fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x, sum.1 + y));
        (sum.0 / count, sum.1 / count)
    } else {
        (0.0, 0.0)
    };
    let product: f64 = samples.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let square: f64 = samples.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    let scale = product / square;
    (scale > 0.0 && scale.is_finite()).then_some(Fit { scale, shift: mean_y - scale * mean_x, inlier_share: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise-free samples of `0.5 · value + 0.01` with a share of outliers.
    fn samples(count: usize, wrong_share: f64) -> Vec<(f64, f64)> {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut sample = || {
            let value = random.random::<f64>();
            let wrong = random.random::<f64>() < wrong_share;
            (value, if wrong { random.random::<f64>() } else { 0.5 * value + 0.01 })
        };
        (0..count).map(|_| sample()).collect()
    }

    #[test]
    fn scale_and_shift_are_recovered_despite_outliers() {
        for wrong_share in [0.0, 0.3, 0.5] {
            let fit = fit_scale_shift(&samples(400, wrong_share)).unwrap();
            let error = (fit.scale - 0.5).abs().max((fit.shift - 0.01).abs());
            assert!(error <= 2e-3, "{wrong_share}: {fit:?}");
            assert!((fit.inlier_share - (1.0 - wrong_share)).abs() <= 0.12, "{wrong_share}: {fit:?}");
        }
        let wrong = least_squares(&samples(400, 0.3), true).unwrap();
        assert!((wrong.scale - 0.5).abs() > 0.05, "the test would pass without robustness: {wrong:?}");
    }

    #[test]
    fn nine_samples_with_two_outliers_suffice() {
        let mono = [0.9, 0.5, 0.7, 0.2, 0.4, 0.8, 0.3, 0.6, 0.1];
        let target = [0.46, 0.26, 0.36, 0.11, 0.21, 0.02, 0.16, 0.31, 0.9];
        let fit = fit_scale_shift(&mono.into_iter().zip(target).collect::<Vec<_>>()).unwrap();
        assert!((fit.scale - 0.5).abs() <= 1e-9 && (fit.shift - 0.01).abs() <= 1e-9, "{fit:?}");
    }

    #[test]
    fn refinement_averages_noise() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut noisy = |(value, target): (f64, f64)| (value, target * (1.0 + 0.02 * (random.random::<f64>() - 0.5)));
        let noisy: Vec<_> = samples(500, 0.3).into_iter().map(&mut noisy).collect();
        let fit = fit_scale_shift(&noisy).unwrap();
        assert!((fit.scale - 0.5).abs() <= 3e-3 && (fit.shift - 0.01).abs() <= 2e-3, "{fit:?}");
    }

    #[test]
    fn a_fit_of_scale_alone_passes_through_the_origin() {
        let samples: Vec<_> =
            (1..40).map(|at| (f64::from(at), if at % 3 == 0 { 9.0 } else { 0.25 * f64::from(at) })).collect();
        let fit = fit_scale(&samples).unwrap();
        assert!((fit.scale - 0.25).abs() <= 1e-9 && fit.shift == 0.0, "{fit:?}");
    }

    #[test]
    fn underdetermined_or_contradictory_samples_are_rejected() {
        assert_eq!(fit_scale_shift(&samples(MIN_SAMPLES - 1, 0.0)), None);
        let constant = vec![(1.0, 2.0); 20];
        assert_eq!(fit_scale_shift(&constant), None);
        let falling: Vec<_> = (1..30).map(|at| (f64::from(at), 40.0 - f64::from(at))).collect();
        assert_eq!(fit_scale_shift(&falling), None, "a negative slope swaps near and far");
        let noise = samples(400, 1.0);
        assert_eq!(fit_scale_shift(&noise), None);
        assert_eq!(fit_scale_shift(&vec![(f64::NAN, 1.0); 20]), None);
    }
}
