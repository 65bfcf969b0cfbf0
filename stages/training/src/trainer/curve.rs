//! The quality curve: PSNR over seconds of training on a few views, measured while the training clock is stopped.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::shared::Curve;

/// One point of the curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Seconds of training, evaluation excluded.
    pub seconds: f64,
    /// Steps over all phases.
    pub iteration: u64,
    /// Number of Gaussians, as in [`crate::ModelHeader::n_gaussians`].
    pub n_gaussians: u64,
    /// Mean PSNR of the 8-bit renders over the curve's views, dB.
    pub psnr_val: f64,
    /// The loss of the last step.
    pub loss: f64,
}

/// The iterations (over all phases) of the curve's points: spaced quadratically, to resolve the steep start.
pub(crate) fn schedule(curve: &Curve, total: u64) -> BTreeSet<u64> {
    let share = |at: u64| (at as f64 / curve.points as f64).powi(2);
    (1..=curve.points).map(|at| ((total as f64 * share(at)).round() as u64).max(1)).collect()
}

/// PSNR of equal images, dB, because the curve is plotted; the same bound as in metric-evaluation.
const MAX_PSNR: f64 = 100.0;

/// Peak signal-to-noise ratio in dB of two 8-bit images of equal size: at most 100 dB.
pub fn psnr(render: &[u8], truth: &[u8]) -> f64 {
    assert_eq!(render.len(), truth.len(), "images of equal size");
    let squared = |(&a, &b): (&u8, &u8)| u64::from(a.abs_diff(b)).pow(2);
    let sum: u64 = render.iter().zip(truth).map(squared).sum();
    (-10.0 * (sum as f64 / (render.len() as f64 * 255.0 * 255.0)).log10()).min(MAX_PSNR)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn psnr_is_bounded_where_images_are_equal() {
        assert_eq!(psnr(&[10, 200], &[10, 200]), 100.0);
        assert!((psnr(&[11, 199], &[10, 200]) - 20.0 * 255f64.log10()).abs() <= 1e-9);
    }

    #[test]
    fn the_schedule_covers_the_training_and_is_denser_at_the_start() {
        let points: Vec<u64> = schedule(&Curve { points: 10, views: 1 }, 1000).into_iter().collect();
        assert_eq!((points[0], points[9], points.len()), (10, 1000, 10));
        assert!(points.windows(3).all(|at| at[1] - at[0] < at[2] - at[1]));
        assert!(schedule(&Curve { points: 0, views: 1 }, 1000).is_empty());
        assert_eq!(schedule(&Curve { points: 40, views: 1 }, 3).into_iter().collect::<Vec<_>>(), [1, 2, 3]);
    }
}
