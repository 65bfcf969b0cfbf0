//! The deformation network: one trunk layer and a small head per attribute, which add to the attributes before their
//! activation (Wu et al. 2024, section 4.3).

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use shaders::linear::Activation;
use shaders::pointwise::add;
use shaders::splat::SplatVars;
use shaders::tape::{Real, Tape, Var};

use crate::bases::gaussians::leading_harmonics;
use crate::bases::layers::{FirstWeights, apply_layer, insert_layer};
use crate::state::{ModelState, Variables};

/// The network's tensors are called `network.…`.
pub const NETWORK: &str = "network.";

/// Which attributes the network moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Heads {
    /// Positions.
    pub position: bool,
    /// Logarithmic scales.
    pub scale: bool,
    /// Raw quaternions.
    pub rotation: bool,
    /// Opacity logits.
    pub opacity: bool,
    /// Spherical harmonics.
    pub harmonics: bool,
}

impl Heads {
    /// No head at all.
    pub const NONE: Self = Self { position: false, scale: false, rotation: false, opacity: false, harmonics: false };
}

impl Default for Heads {
    fn default() -> Self {
        Self { position: true, scale: true, rotation: true, ..Self::NONE }
    }
}

/// Sizes of the network.
pub struct Network {
    features: usize,
    width: usize,
    heads: Heads,
    sh_count: usize,
}

impl Network {
    /// `features` → `width` → heads; `sh_count` harmonics per channel.
    pub fn new(features: usize, width: usize, heads: Heads, sh_count: usize) -> Self {
        Self { features, width, heads, sh_count }
    }

    /// Adds trunk and heads.
    pub fn insert<T: Real>(&self, state: &mut ModelState<T>, zero_heads: bool, random: &mut ChaCha8Rng) {
        let last = if zero_heads { FirstWeights::Zero } else { FirstWeights::Xavier };
        insert_layer(state, "network.trunk", self.features, self.width, FirstWeights::Xavier, random);
        for (head, outputs) in self.head_outputs() {
            insert_layer(state, &format!("network.{head}.0"), self.width, self.width, FirstWeights::Xavier, random);
            insert_layer(state, &format!("network.{head}.1"), self.width, outputs, last, random);
        }
    }

    /// Splats plus what the heads say at features [N, F].
    pub fn deform<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        features: Var,
        canonical: SplatVars,
        sh_degree: usize,
    ) -> SplatVars {
        // Every head begins with a ReLU, which the trunk applies once for all of them.
        let hidden = apply_layer(tape, model, "network.trunk", features, Activation::Relu);
        let Heads { position, scale, rotation, opacity, harmonics } = self.heads;
        let mut moved = |on: bool, head: &str, attribute: Var| {
            if !on {
                return attribute;
            }
            let change = Self::head(tape, model, head, hidden);
            let change = if head == "harmonics" { leading_harmonics(tape, change, sh_degree) } else { change };
            add(tape, attribute, change)
        };
        SplatVars {
            positions: moved(position, "position", canonical.positions),
            log_scales: moved(scale, "scale", canonical.log_scales),
            rotations: moved(rotation, "rotation", canonical.rotations),
            opacity_logits: moved(opacity, "opacity", canonical.opacity_logits),
            sh: moved(harmonics, "harmonics", canonical.sh),
        }
    }

    fn head<T: Real>(tape: &mut Tape<T>, model: &Variables, head: &str, hidden: Var) -> Var {
        let inner = apply_layer(tape, model, &format!("network.{head}.0"), hidden, Activation::Relu);
        apply_layer(tape, model, &format!("network.{head}.1"), inner, Activation::Identity)
    }

    fn head_outputs(&self) -> impl Iterator<Item = (&'static str, usize)> {
        let Heads { position, scale, rotation, opacity, harmonics } = self.heads;
        let all = [
            (position, "position", 3),
            (scale, "scale", 3),
            (rotation, "rotation", 4),
            (opacity, "opacity", 1),
            (harmonics, "harmonics", 3 * self.sh_count),
        ];
        all.into_iter().filter(|(on, ..)| *on).map(|(_, head, outputs)| (head, outputs))
    }
}
