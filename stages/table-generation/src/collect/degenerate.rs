//! Degenerate runs: the values that show it, the likely causes, and remedies to try.

use metric_evaluation::{Degenerate, Trivial};
use serde::{Deserialize, Serialize};

use crate::format::number;

/// Share of background pixels in the ground truth above which the background is named as a likely cause. A model that
/// shows nothing but the background is then nearly as good as one that shows the subject.
const MUCH_BACKGROUND: f64 = 0.85;

/// Number of Gaussians below which a model is nearly empty; ordinary ones have thousands.
const FEW_GAUSSIANS: f64 = 200.0;

/// Number of steps below which no method shows much; published schedules have tens of thousands.
const FEW_STEPS: u64 = 2000;

/// A run whose renders show no more than an image that needs no model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DegenerateRun {
    /// Why the renders are degenerate.
    pub kind: Degenerate,
    /// The reason with its values, e.g. the PSNR of the best constant image.
    pub message: String,
    /// Likely causes with what to try, the likeliest first.
    pub advice: Vec<String>,
}

/// The properties of a run's training.
pub(super) struct Circumstances<'a> {
    /// Number of Gaussians in the model.
    pub n_gaussians: Option<f64>,
    /// Scale of the method's own schedule.
    pub schedule_scale: Option<f64>,
    /// Whether the schedule was scaled to a budget.
    pub has_budget: bool,
    /// Number of optimiser steps.
    pub n_steps: Option<u64>,
    /// Notices that the training reported.
    pub notices: &'a [String],
}

impl DegenerateRun {
    /// Describes a degenerate run from its values; `trivial` is about its ground truth.
    pub(super) fn new(kind: Degenerate, psnr: f64, trivial: &Trivial, training: &Circumstances<'_>) -> Self {
        let mut message = format!(
            "{}: {} dB; best constant image: {} dB",
            kind.about(),
            number(psnr, 2),
            number(trivial.constant_psnr, 2)
        );
        if kind == Degenerate::NotAboveMeanImage {
            let mean = trivial.mean_image.map_or(f64::NAN, |mean| mean.psnr);
            message += &format!("; temporal mean image: {} dB", number(mean, 2));
        }
        Self { kind, message, advice: advice(kind, trivial, training) }
    }
}

/// A share in percent, with a digit that is not 0.
fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    let decimals = if percent < 10.0 { (-percent.log10().floor()).clamp(1.0, 12.0) } else { 0.0 };
    number(percent, decimals as usize)
}

/// Likely causes, by what was measured.
fn advice(kind: Degenerate, trivial: &Trivial, training: &Circumstances<'_>) -> Vec<String> {
    let n_gaussians = training.n_gaussians;
    let background = trivial.background_share.filter(|share| *share >= MUCH_BACKGROUND).map(|share| {
        format!(
            "{} % of the ground truth's pixels have the background's colour: try another `background` of the capture \
             (e.g. black instead of white)",
            number(100.0 * share, 0)
        )
    });
    let few = n_gaussians.filter(|count| *count < FEW_GAUSSIANS).map(|count| {
        format!(
            "{} Gaussians are left: give the capture a point cloud or bounds, start from more points \
             (`initial_points.random_count`), or prune less (`density.min_opacity`)",
            number(count, 0)
        )
    });
    let short = training.schedule_scale.filter(|scale| *scale < 1.0).map(|scale| {
        format!(
            "a schedule of {} % may be the cause: increase `schedule_scale`{}",
            percent(scale),
            if training.has_budget { " or `--budget`" } else { "" }
        )
    });
    let hasty = training
        .n_steps
        .filter(|count| short.is_none() && *count < FEW_STEPS)
        .map(|count| format!("{count} iterations are few: increase `iterations` (or `schedule_scale`)"));
    let unseen = (kind != Degenerate::NotAboveMeanImage && few.is_none()).then(|| {
        let count = n_gaussians.map_or_else(|| "the".into(), |count| format!("the {}", number(count, 0)));
        format!("{count} Gaussians may lie outside of what the cameras see: check the capture's points or bounds")
    });
    let still = (kind == Degenerate::NotAboveMeanImage)
        .then(|| "the motion model has learnt nothing useful: compare with a static method".to_owned());
    training
        .notices
        .iter()
        .cloned()
        .chain([background, few, short, hasty, still, unseen].into_iter().flatten())
        .collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn short_schedules_do_not_round_to_nothing() {
        assert_eq!(
            [0.25, 0.1, 0.03, 0.004, 0.00034, 2e-5].map(super::percent),
            ["25", "10", "3.0", "0.4", "0.03", "0.002"]
        );
    }
}
