//! The deformation network: heads that add to the attributes of Gaussians before their activation (Wu et al. 2024,
//! section 4.3).

use serde::{Deserialize, Serialize};
use shaders::pointwise::{add, adds};
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Var};

use crate::bases::gaussians::leading_harmonics;
use crate::bases::heads::{HeadedNetwork, POSITION, in_scene_units};
use crate::data::Streams;
use crate::model::{ModelState, Variables};

/// The name of the network, the prefix of its tensors.
pub(crate) const NETWORK: &str = "network";

/// The attributes that the network changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Heads {
    /// Change positions.
    pub position: bool,
    /// Change logarithmic scales.
    pub scale: bool,
    /// Change raw quaternions.
    pub rotation: bool,
    /// Change opacity logits.
    pub opacity: bool,
    /// Change spherical harmonics.
    pub harmonics: bool,
}

impl Heads {
    /// No head at all.
    pub(crate) const NONE: Self =
        Self { position: false, scale: false, rotation: false, opacity: false, harmonics: false };

    /// Name and number of outputs of the heads that are on, always in this order.
    fn outputs(self, sh_count: usize) -> Vec<(&'static str, usize)> {
        let all = [
            (self.position, POSITION, 3),
            (self.scale, "scale", 3),
            (self.rotation, "rotation", 4),
            (self.opacity, "opacity", 1),
            (self.harmonics, "harmonics", 3 * sh_count),
        ];
        all.into_iter().filter(|(on, ..)| *on).map(|(_, head, outputs)| (head, outputs)).collect()
    }
}

impl Default for Heads {
    fn default() -> Self {
        Self { position: true, scale: true, rotation: true, ..Self::NONE }
    }
}

/// Name and number of outputs of a head that a method adds; it starts at zero.
pub(crate) type FurtherHead = (&'static str, usize);

/// The network and the attributes that it changes.
pub(crate) struct Network {
    layers: HeadedNetwork,
    heads: Heads,
    unit_world: f64,
}

impl Network {
    /// A network `features` → `width` → heads, with further heads that change no attribute; `sh_count` harmonics per
    /// channel. Displacements are in `unit_world` scene units.
    pub(crate) fn new(
        features: usize,
        width: usize,
        heads: Heads,
        sh_count: usize,
        further_heads: &[FurtherHead],
        unit_world: f64,
    ) -> Self {
        let layers = HeadedNetwork::new(NETWORK, features, width, heads.outputs(sh_count));
        Self { layers: layers.with_silent_heads(further_heads.to_vec()), heads, unit_world }
    }

    /// Adds trunk and heads.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, zero_heads: bool, random: Streams) {
        self.layers.insert(state, zero_heads, random);
    }

    /// Splats plus the outputs of the heads at features [N, F].
    pub(crate) fn deform<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        features: Var,
        canonical: SplatVars,
        sh_degree: usize,
    ) -> SplatVars {
        let hidden = self.layers.hidden(tape, model, features);
        let (log_scales, rotations) = canonical.shape.scales_and_rotations().expect("Gaussians have both");
        let attributes = [
            (POSITION, canonical.positions),
            ("scale", log_scales),
            ("rotation", rotations),
            ("opacity", canonical.opacity_logits),
            ("harmonics", canonical.sh),
        ];
        let heads: Vec<&str> = self.heads.outputs(1).into_iter().map(|(head, _)| head).collect();
        let mut changes = self.layers.heads(tape, model, &heads, hidden);
        if let Some(at) = heads.iter().position(|&head| head == "harmonics") {
            changes[at] = leading_harmonics(tape, changes[at], sh_degree);
        }
        if let Some(at) = heads.iter().position(|&head| head == POSITION) {
            changes[at] = in_scene_units(tape, changes[at], self.unit_world);
        }
        let moved = attributes.iter().filter(|(head, _)| heads.contains(head));
        let pairs: Vec<[Var; 2]> = moved.zip(changes).map(|(&(_, attribute), change)| [attribute, change]).collect();
        let mut sums = adds(tape, &pairs).into_iter();
        let mut moved = |(head, attribute): (&str, Var)| match heads.contains(&head) {
            true => sums.next().expect("a sum for every head"),
            false => attribute,
        };
        let [positions, log_scales, rotations, opacity_logits, sh] = attributes.map(&mut moved);
        let shape = ShapeVars::ScaleRotation { log_scales, rotations };
        SplatVars { positions, shape, opacity_logits, sh }
    }

    /// Positions [N, 3] plus the output of their head at features [N, F], and the common input of the other heads.
    pub(crate) fn move_points<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        features: Var,
        positions: Var,
    ) -> MovedPoints {
        let hidden = self.layers.hidden(tape, model, features);
        let change = self.layers.displacements(tape, model, hidden, self.unit_world);
        MovedPoints { positions: add(tape, positions, change), hidden }
    }

    /// The output of a further head.
    pub(crate) fn further_head<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, head: &str, hidden: Var) -> Var {
        self.layers.head(tape, model, head, hidden)
    }
}

/// Points at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MovedPoints {
    /// [N, 3] world positions.
    pub positions: Var,
    /// [N, width] common input of all heads.
    pub hidden: Var,
}
