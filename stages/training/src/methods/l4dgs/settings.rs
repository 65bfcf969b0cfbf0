use serde::{Deserialize, Serialize};

use crate::bases::hexplane::HexplaneSettings;

/// The base, the teacher and the semantic losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct L4dgsSettings {
    /// Field, network and their training.
    pub hexplane: HexplaneSettings,
    /// What the semantic features of the Gaussians are taught by.
    pub teacher: TeacherSettings,
    /// Weights of the semantic losses.
    pub weights: LossWeights,
    /// Iterations of `fine`, before stretching, over which the semantic losses grow from nothing to their weight.
    pub ramp: [u64; 2],
    /// Semantic losses are evaluated every so many iterations.
    pub interval: u64,
    /// Losses between two instants, which take a second render, are evaluated every so many iterations.
    pub dynamic_interval: u64,
    /// Tokens, and cells of depth, that the Gaussians cover with less opacity show no surface and count nothing.
    pub min_alpha: f64,
    /// Step size of the semantic features.
    pub semantic_rate: f64,
    /// What the scene may show, where no embeddings are given: each prompt stands for a fixed direction.
    pub prompts: Vec<String>,
}

/// The central-difference network, the attention and the decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TeacherSettings {
    /// Image pixels per token, at least.
    pub pixels_per_token: usize,
    /// Tokens along the longer side of the image, at most.
    pub tokens_per_side: usize,
    /// Channels of the three levels.
    pub channels: [usize; 3],
    /// θ: the share of the central difference in every convolution.
    pub theta: f64,
    /// Width of a token within the attention.
    pub width: usize,
    /// Heads of the attention.
    pub heads: usize,
    /// Tokens that a token attends to.
    pub top_k: usize,
    /// Prompts that a token attends to.
    pub text_top_k: usize,
    /// Width of a semantic feature.
    pub features: usize,
    /// Width of the decoder's hidden layer.
    pub decoder_width: usize,
    /// Step size.
    pub rate: f64,
}

/// The weights of equations 3 to 10.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossWeights {
    /// Of all semantic and depth losses together.
    pub semantics: f64,
    /// λ: of the angle between features, equations 3 and 4.
    pub angle: f64,
    /// λ_Static: of depth at one instant, equation 5.
    pub static_depth: f64,
    /// λ_D: of the angle between changes, equation 7.
    pub change_angle: f64,
    /// λ_Dynamic: of depth between instants, equation 9.
    pub dynamic_depth: f64,
    /// λ_O: of what concerns one instant, equation 10.
    pub statics: f64,
}

impl Default for L4dgsSettings {
    fn default() -> Self {
        let prompts = ["person", "animal", "ball", "toy", "furniture", "plant", "floor", "background"];
        Self {
            hexplane: HexplaneSettings::default(),
            teacher: TeacherSettings::default(),
            weights: LossWeights::default(),
            ramp: [1000, 3000],
            interval: 2,
            dynamic_interval: 4,
            min_alpha: 0.5,
            semantic_rate: 2.5e-3,
            prompts: prompts.map(String::from).to_vec(),
        }
    }
}

impl Default for TeacherSettings {
    fn default() -> Self {
        Self {
            pixels_per_token: 4,
            tokens_per_side: 32,
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
        Self { semantics: 0.05, angle: 0.1, static_depth: 0.1, change_angle: 0.1, dynamic_depth: 0.1, statics: 1.0 }
    }
}

/// Wider layers or more tokens than this were mistyped: the attention of 128² tokens takes a gigabyte.
const MOST: usize = 4096;
const MOST_TOKENS_PER_SIDE: usize = 128;

impl L4dgsSettings {
    /// Small, with every part in use from the first iteration.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            hexplane: HexplaneSettings::tiny(),
            teacher: TeacherSettings {
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
            },
            ramp: [0, 0],
            interval: 1,
            dynamic_interval: 1,
            // The first Gaussians are faint.
            min_alpha: 2e-3,
            ..Self::default()
        }
    }

    /// Why these settings cannot work, if so.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.hexplane.check()?;
        let TeacherSettings { pixels_per_token, tokens_per_side, channels, theta, width, heads, .. } = self.teacher;
        let TeacherSettings { top_k, text_top_k, features, decoder_width, rate, .. } = self.teacher;
        let LossWeights { semantics, angle, static_depth, change_angle, dynamic_depth, statics } = self.weights;
        let weights = [semantics, angle, static_depth, change_angle, dynamic_depth, statics];
        let sizes = [pixels_per_token, width, heads, top_k, text_top_k, features, decoder_width];
        let few = |size: &usize| (1..=MOST).contains(size);
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let good = [
            (sizes.iter().chain(&channels).all(few), "sizes of the teacher must be 1 to 4096"),
            ((1..=MOST_TOKENS_PER_SIDE).contains(&tokens_per_side), "tokens_per_side must be 1 to 128"),
            (width.is_multiple_of(heads.max(1)), "heads must divide the width of a token"),
            ((0.0..=1.0).contains(&theta), "theta must be in [0, 1]"),
            (positive(rate) && positive(self.semantic_rate), "rates must be positive"),
            (weights.iter().all(|&weight| weight >= 0.0 && weight.is_finite()), "weights must not be negative"),
            (self.interval > 0 && self.dynamic_interval > 0, "intervals must be at least 1"),
            ((0.0..=1.0).contains(&self.min_alpha), "min_alpha must be in [0, 1]"),
            (self.ramp[0] <= self.ramp[1], "the ramp must not end before it begins"),
            (!self.prompts.is_empty(), "prompts must not be empty"),
        ];
        good.iter().find(|(good, _)| !good).map_or(Ok(()), |(_, message)| Err(message.to_string()))
    }
}
