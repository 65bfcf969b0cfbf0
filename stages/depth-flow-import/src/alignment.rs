//! Robust fit of a scale and a shift.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random pairs that are tried: with half of the samples wrong, all fail with a probability of 10⁻¹⁸.
const TRIALS: usize = 150;
/// A sample supports a fit if it is off by less than this share of its own value …
const INLIER_SHARE: f64 = 0.05;
/// … for the first fit, and by this multiple of the robust spread for the final one.
const SPREAD_MULTIPLE: f64 = 2.5;
/// Fewer samples say nothing about two numbers.
pub const MIN_SAMPLES: usize = 8;
/// Fits that fewer samples support are refused.
pub const MIN_INLIER_SHARE: f64 = 0.3;
/// Rounds of least squares on the samples that support the last fit.
const REFINEMENTS: usize = 10;
/// The median absolute deviation of normal noise is this much smaller than its standard deviation.
const MAD_OF_NORMAL: f64 = 0.6745;

/// `target ≈ scale · value + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Factor.
    pub scale: f64,
    /// Offset.
    pub shift: f64,
    /// Share of the samples that agree.
    pub inlier_share: f64,
}

impl Fit {
    /// The aligned value.
    pub fn apply(&self, value: f64) -> f64 {
        self.scale * value + self.shift
    }
}

/// Fits `target ≈ scale · value + shift` (positive targets) to pairs of (value, target) of which a part may be wrong:
/// random sampling for a first fit (Fischler and Bolles 1981), least squares on those that agree for the final one.
///
/// `None` where there are too few samples, where too few agree, or where no positive scale fits.
pub fn fit_scale_shift(samples: &[(f64, f64)]) -> Option<Fit> {
    fit(samples, true)
}

/// As [`fit_scale_shift`], without a shift.
pub fn fit_scale(samples: &[(f64, f64)]) -> Option<Fit> {
    fit(samples, false)
}

fn fit(samples: &[(f64, f64)], with_shift: bool) -> Option<Fit> {
    if samples.len() < MIN_SAMPLES {
        return None;
    }
    // A fixed seed: equal samples give equal fits.
    let mut random = ChaCha8Rng::seed_from_u64(samples.len() as u64);
    let mut candidate = || {
        let first = random.random_range(0..samples.len());
        let second = (first + random.random_range(1..samples.len())) % samples.len();
        let pair = if with_shift { vec![samples[first], samples[second]] } else { vec![samples[first]] };
        least_squares(&pair, with_shift)
    };
    let tolerance = |target: f64| INLIER_SHARE * target.abs();
    let agreeing = |fit: &Fit| samples.iter().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).count();
    let candidates = (0..TRIALS).filter_map(|_| candidate()).map(|fit| (agreeing(&fit), fit));
    // The first of the best.
    let best = candidates.reduce(|best, next| if next.0 > best.0 { next } else { best });
    let mut fit = best?.1;
    let mut inliers: Vec<_> =
        samples.iter().copied().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).collect();
    for _ in 0..REFINEMENTS {
        fit = least_squares(&inliers, with_shift)?;
        let spread = median(inliers.iter().map(|(x, y)| (fit.apply(*x) - y).abs()))? / MAD_OF_NORMAL;
        let agrees = |(x, y): &(f64, f64)| {
            let error = (fit.apply(*x) - y).abs();
            // Samples without noise have no spread; rounding must not throw them out.
            error <= tolerance(*y) && error <= SPREAD_MULTIPLE * spread + 1e-9 * y.abs()
        };
        inliers = samples.iter().copied().filter(agrees).collect();
    }
    let agreeing = samples.iter().filter(|(x, y)| (fit.apply(*x) - y).abs() <= tolerance(*y)).count();
    fit.inlier_share = agreeing as f64 / samples.len() as f64;
    (fit.inlier_share >= MIN_INLIER_SHARE).then_some(fit)
}

/// The least-squares line (through the origin without a shift); `None` where the values do not determine one with a
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

/// The middle value; `None` of nothing.
pub fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise-free samples of `0.5 · value + 0.01` with a share of wrong ones.
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
    fn a_planted_scale_and_shift_survive_wrong_samples() {
        for wrong_share in [0.0, 0.3, 0.5] {
            let fit = fit_scale_shift(&samples(400, wrong_share)).unwrap();
            let error = (fit.scale - 0.5).abs().max((fit.shift - 0.01).abs());
            assert!(error <= 2e-3, "{wrong_share}: {fit:?}");
            assert!((fit.inlier_share - (1.0 - wrong_share)).abs() <= 0.12, "{wrong_share}: {fit:?}");
        }
        let wrong = least_squares(&samples(400, 0.3), true).unwrap();
        assert!((wrong.scale - 0.5).abs() > 0.05, "plain least squares would pass this test too: {wrong:?}");
    }

    #[test]
    fn nine_samples_with_two_outliers_are_enough() {
        let mono = [0.9, 0.5, 0.7, 0.2, 0.4, 0.8, 0.3, 0.6, 0.1];
        let target = [0.46, 0.26, 0.36, 0.11, 0.21, 0.02, 0.16, 0.31, 0.9];
        let fit = fit_scale_shift(&mono.into_iter().zip(target).collect::<Vec<_>>()).unwrap();
        assert!((fit.scale - 0.5).abs() <= 1e-9 && (fit.shift - 0.01).abs() <= 1e-9, "{fit:?}");
    }

    #[test]
    fn noise_is_averaged() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut noisy = |(value, target): (f64, f64)| (value, target * (1.0 + 0.02 * (random.random::<f64>() - 0.5)));
        let noisy: Vec<_> = samples(500, 0.3).into_iter().map(&mut noisy).collect();
        let fit = fit_scale_shift(&noisy).unwrap();
        assert!((fit.scale - 0.5).abs() <= 3e-3 && (fit.shift - 0.01).abs() <= 2e-3, "{fit:?}");
    }

    #[test]
    fn a_scale_alone_is_fitted_through_the_origin() {
        let samples: Vec<_> =
            (1..40).map(|at| (f64::from(at), if at % 3 == 0 { 9.0 } else { 0.25 * f64::from(at) })).collect();
        let fit = fit_scale(&samples).unwrap();
        assert!((fit.scale - 0.25).abs() <= 1e-9 && fit.shift == 0.0, "{fit:?}");
    }

    #[test]
    fn what_says_nothing_is_refused() {
        assert_eq!(fit_scale_shift(&samples(MIN_SAMPLES - 1, 0.0)), None);
        let constant = vec![(1.0, 2.0); 20];
        assert_eq!(fit_scale_shift(&constant), None);
        let falling: Vec<_> = (1..30).map(|at| (f64::from(at), 40.0 - f64::from(at))).collect();
        assert_eq!(fit_scale_shift(&falling), None, "near and far are exchanged");
        let noise = samples(400, 1.0);
        assert_eq!(fit_scale_shift(&noise), None);
        assert_eq!(fit_scale_shift(&vec![(f64::NAN, 1.0); 20]), None);
    }
}
