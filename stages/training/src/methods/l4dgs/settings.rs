//! Settings specific to L4DGS.

use serde::{Deserialize, Serialize};

use crate::bases::hexplane::HexplaneSettings;
use crate::check::{Checks, Table, fields};

/// Settings of the base, the teacher and the semantic losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct L4dgsSettings {
    /// The field, the network and their training.
    pub hexplane: HexplaneSettings,
    /// The teacher of the semantic features.
    pub teacher: TeacherSettings,
    /// Shares of the semantic losses.
    pub shares: LossShares,
    /// λ, the weight of the angle between features (equation 3) and between centred depths (equation 4) relative to their
    /// distance.
    pub angle: f64,
    /// λ_D, the weight of the angle between changes (equation 7) relative to their distance.
    pub change_angle: f64,
    /// Iterations of `fine`, before stretching, over which the semantic losses grow from 0 to their share.
    pub ramp: [u64; 2],
    /// Interval of the semantic losses, in iterations. Density control observes the other iterations, or all of them if there
    /// are no others.
    pub interval: u64,
    /// Interval of the losses between two instants, which need a second render, in iterations.
    pub dynamic_interval: u64,
    /// Minimum opacity of tokens and depth cells; those with less show no surface and have no weight.
    pub min_alpha: f64,
    /// Learning rate of the semantic features.
    pub semantic_rate: f64,
}

/// The central-difference network, the attention and the decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TeacherSettings {
    /// Iterations of the phase `teacher`. `schedule_scale` does not scale them: the task of the teacher does not shrink
    /// with the schedule of the Gaussians.
    pub iterations: u64,
    /// Minimum number of image pixels along a token's side.
    pub pixels_per_token: usize,
    /// Maximum number of tokens along the longer side of the image.
    pub tokens_per_side: usize,
    /// Channels of the three convolution levels.
    pub channels: [usize; 3],
    /// θ, the share of the central difference in every convolution.
    pub theta: f64,
    /// Width of a token in the attention.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Number of tokens that a token attends to.
    pub top_k: usize,
    /// Number of prompts that a token attends to.
    pub text_top_k: usize,
    /// Width of a semantic feature.
    pub features: usize,
    /// Width of the decoder's hidden layer.
    pub decoder_width: usize,
    /// Learning rate of the teacher.
    pub rate: f64,
}

/// Weights of the semantic losses, as shares of the photometric gradient of the positions at the start: means over all
/// steps, of which only some evaluate the loss. They stand for λ_O, λ_Static and λ_Dynamic of equations 5, 9 and 10.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossShares {
    /// Features at one instant (equation 3).
    pub static_semantics: f64,
    /// The effect `perceptual-semantics`.
    pub perceptual_semantics: f64,
    /// Depth at one instant (equation 4).
    pub static_depth: f64,
    /// Changes of features (equation 7). They have no gradient until something moves, so the share is that of the distance
    /// of features at one instant (equation 3).
    pub dynamic_semantics: f64,
    /// Changes of depth (equation 8). The share is that of the variance of depths at one instant.
    pub dynamic_depth: f64,
}

impl Default for L4dgsSettings {
    fn default() -> Self {
        Self {
            hexplane: HexplaneSettings::default(),
            teacher: TeacherSettings::default(),
            shares: LossShares::default(),
            angle: 0.1,
            change_angle: 0.1,
            ramp: [1000, 3000],
            interval: 2,
            dynamic_interval: 16,
            min_alpha: 0.5,
            semantic_rate: 2.5e-3,
        }
    }
}

impl Default for TeacherSettings {
    fn default() -> Self {
        Self {
            iterations: 2000,
            pixels_per_token: 4,
            tokens_per_side: 24,
            channels: [32, 64, 64],
            theta: 0.7,
            width: 64,
            heads: 4,
            top_k: 32,
            text_top_k: 4,
            features: 16,
            decoder_width: 64,
            rate: 1e-3,
        }
    }
}

impl Default for LossShares {
    fn default() -> Self {
        Self {
            static_semantics: 0.005,
            perceptual_semantics: 0.005,
            static_depth: 0.02,
            dynamic_semantics: 0.000625,
            dynamic_depth: 0.02,
        }
    }
}

/// Limits against typing errors: the attention of 128² tokens already takes a gigabyte.
const MOST: usize = 4096;
const MOST_TOKENS_PER_SIDE: usize = 128;

impl L4dgsSettings {
    /// Small settings with every part in use from the first iteration.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            hexplane: HexplaneSettings::tiny(),
            teacher: TeacherSettings {
                iterations: 6,
                pixels_per_token: 4,
                channels: [4, 4, 4],
                width: 8,
                heads: 2,
                top_k: 6,
                text_top_k: 2,
                features: 4,
                decoder_width: 8,
                ..TeacherSettings::default()
            },
            shares: LossShares {
                static_semantics: 1.0,
                perceptual_semantics: 1.0,
                static_depth: 1.0,
                dynamic_semantics: 1.0,
                dynamic_depth: 1.0,
            },
            angle: 1.0,
            change_angle: 1.0,
            ramp: [0, 0],
            interval: 1,
            dynamic_interval: 1,
            // Low, because the initial Gaussians are nearly transparent.
            min_alpha: 2e-3,
            ..Self::default()
        }
    }
}

impl Table for L4dgsSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("hexplane", &self.hexplane)
            .table("teacher", &self.teacher)
            .not_negative(fields!(self, shares.static_semantics, shares.perceptual_semantics, shares.static_depth))
            .not_negative(fields!(self, shares.dynamic_semantics, shares.dynamic_depth, angle, change_angle))
            .require("ramp", self.ramp[0] <= self.ramp[1], "must not end before it begins")
            .at_least_one(fields!(self, interval, dynamic_interval))
            .shares(fields!(self, min_alpha))
            .rates(fields!(self, semantic_rate))
    }
}

impl Table for TeacherSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .counts(MOST, fields!(self, pixels_per_token, width, heads, top_k, text_top_k, features, decoder_width))
            .counts(MOST_TOKENS_PER_SIDE, fields!(self, tokens_per_side))
            .list_of_counts(MOST, "channels", &self.channels)
            .require("heads", self.width.is_multiple_of(self.heads.max(1)), "must divide width")
            .shares(fields!(self, theta))
            .rates(fields!(self, rate))
    }
}
