//! Mean, spread, and confidence intervals of means.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Arithmetic mean; none for an empty slice.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation (divisor n − 1); none for fewer than two values.
pub fn sample_std(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Median (the mean of the middle two for an even count); none for an empty slice.
pub(crate) fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[middle]),
        _ => Some((sorted[middle - 1] + sorted[middle]) / 2.0),
    }
}

/// Half the width of the 95 % interval of the mean of `n` values with standard deviation `std`; none for fewer than
/// two.
pub fn half_width(std: f64, n: usize) -> Option<f64> {
    (n > 1).then(|| t_quantile((n - 1) as f64) * std / (n as f64).sqrt())
}

/// The 97.5 % quantile of Student's t distribution.
fn t_quantile(freedom: f64) -> f64 {
    // `new` fails only if `freedom` is not positive, and callers pass at least one degree of freedom.
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |t| t.inverse_cdf(0.975))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_match_student() {
        // Three values 1, 2, 3: standard deviation 1, t(2) = 4.303.
        let width = half_width(1.0, 3).expect("three values");
        assert!((width - 4.303 / 3.0_f64.sqrt()).abs() <= 1e-3);
        assert_eq!(half_width(1.0, 1), None);
        assert!((t_quantile(60.0) - 2.000).abs() <= 1e-3);
    }
}
