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
    /// Weights of the semantic losses.
    pub weights: LossWeights,
    /// Iterations of `fine`, before stretching, over which the semantic losses grow from 0 to their weight.
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

/// Weights of equations 3 to 10.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossWeights {
    /// Weight of all semantic and depth losses together.
    pub semantics: f64,
    /// λ, the weight of the angle between features (equation 3) and between centred depths (equation 4).
    pub angle: f64,
    /// λ_Static, the weight of depth at one instant (equation 5).
    pub static_depth: f64,
    /// λ_D, the weight of the angle between changes (equation 7).
    pub change_angle: f64,
    /// λ_Dynamic, the weight of depth between instants (equation 9).
    pub dynamic_depth: f64,
    /// λ_O, the weight of the losses at one instant (equation 10).
    pub statics: f64,
    /// The weight of the effect `perceptual-semantics`.
    pub perceptual: f64,
}

impl Default for L4dgsSettings {
    fn default() -> Self {
        Self {
            hexplane: HexplaneSettings::default(),
            teacher: TeacherSettings::default(),
            weights: LossWeights::default(),
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

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            semantics: 0.002,
            angle: 0.1,
            static_depth: 2.5,
            change_angle: 0.1,
            dynamic_depth: 75.0,
            statics: 1.0,
            perceptual: 1.0,
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
            weights: LossWeights {
                semantics: 1.0,
                angle: 1.0,
                static_depth: 1.0,
                change_angle: 1.0,
                dynamic_depth: 1.0,
                statics: 1.0,
                perceptual: 1.0,
            },
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
            .not_negative(fields!(self, weights.semantics, weights.angle, weights.change_angle, weights.perceptual))
            .not_negative(fields!(self, weights.statics, weights.static_depth, weights.dynamic_depth))
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
