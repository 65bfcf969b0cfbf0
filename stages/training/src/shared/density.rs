//! The table `density`.

use serde::{Deserialize, Serialize};
use shaders::rasteriser::screen::StepGradient;

use crate::check::{Checks, MAX_GAUSSIANS, Table, fields};

/// Adaptive density control (Kerbl et al. 2023, section 5.2, with the constants of its code).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Density {
    /// Threshold of cloning and splitting: the mean norm of the gradient with respect to the projected mean, in normalised
    /// device coordinates (gradients with respect to pixels times half the image size).
    pub gradient_threshold: f64,
    /// The gradient that a step with several views contributes.
    pub batch_gradient: BatchGradient,
    /// Iterations between two rounds of cloning and splitting. `schedule_scale` does not stretch them, because the statistics of a
    /// round need as many steps.
    pub interval: u64,
    /// No rounds up to and including this iteration.
    pub from: u64,
    /// No rounds from this iteration on; 0: no rounds at all.
    pub until: u64,
    /// Gaussians larger than this share of the extent are split, smaller ones are cloned.
    pub split_above: f64,
    /// Iterations between two rounds of pruning, not stretched either.
    pub prune_interval: u64,
    /// Populations of up to this many Gaussians are not pruned.
    pub prune_above_count: usize,
    /// Gaussians less opaque than this are pruned.
    pub min_opacity: f64,
    /// Gaussians larger than this share of the extent are pruned, once opacities have been reset.
    pub max_scale: f64,
    /// Iterations between two resets of the opacity; 0: never.
    pub opacity_reset_interval: u64,
    /// Upper bound of the opacity after a reset.
    pub opacity_reset_to: f64,
    /// Maximum number of Gaussians, or of anchors that spawn several Gaussians each. A round that would exceed it
    /// clones and splits only those with the largest gradients. Initial points beyond it are kept.
    pub max_count: usize,
}

/// The gradient of a Gaussian in a step with several views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum BatchGradient {
    /// The norm of the gradient of the step's loss, in which every view has its share (published for 4DGaussians).
    #[default]
    OfSum,
    /// The mean over the views that show the Gaussian, each as if it were alone in its step (published for 4D-GS).
    MeanOverViews,
}

impl From<BatchGradient> for StepGradient {
    fn from(gradient: BatchGradient) -> Self {
        match gradient {
            BatchGradient::OfSum => Self::OfSum,
            BatchGradient::MeanOverViews => Self::MeanOverViews,
        }
    }
}

impl Default for Density {
    fn default() -> Self {
        Self {
            gradient_threshold: 2e-4,
            batch_gradient: BatchGradient::default(),
            interval: 100,
            from: 500,
            until: 15_000,
            split_above: 0.01,
            prune_interval: 100,
            prune_above_count: 0,
            min_opacity: 0.005,
            max_scale: 0.1,
            opacity_reset_interval: 3000,
            opacity_reset_to: 0.01,
            max_count: 1_000_000,
        }
    }
}

impl Table for Density {
    fn check(&self) -> Checks {
        let has_rounds = self.until == 0 || self.from < self.until;
        let message =
            format!("must be above from ({}): there would be no round; 0 turns density control off", self.from);
        Checks::default()
            .at_least_one(fields!(self, interval, prune_interval))
            .require("until", has_rounds, message)
            .positive(fields!(self, gradient_threshold, split_above, max_scale))
            .counts(MAX_GAUSSIANS, fields!(self, max_count))
            .open_shares(fields!(self, min_opacity, opacity_reset_to))
    }
}
