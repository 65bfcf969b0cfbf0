//! Recipe settings of 4D-GS.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};
use crate::effects::{Effect, Effects, Need, SEED_FROM_MASKS};

/// The method's table in a recipe: the unit of time, and the loss of the effect `rigid`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// Length of the clip in the method's unit of time, in which initial lifetimes (√(0.2·L)), step sizes of times and
    /// rotations between space and time are measured: 1 for D-NeRF, the seconds of a multi-view video (10 for N3V).
    pub clip_length: f64,
    /// Weight of the rigidity loss.
    pub rigid_weight: f64,
    /// Number of random Gaussians per step that are compared with their neighbours (published code: all).
    pub rigid_samples: usize,
    /// Number of Gaussians with which each is compared: itself and the nearest others.
    pub rigid_neighbors: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { clip_length: 1.0, rigid_weight: 1.0, rigid_samples: 4096, rigid_neighbors: 20 }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .positive(fields!(self, clip_length))
            .not_negative(fields!(self, rigid_weight))
            .at_least_one(fields!(self, rigid_samples))
            .require("rigid_neighbors", self.rigid_neighbors >= 2, "must be at least 2: the Gaussian itself counts")
    }
}

/// The active effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Switches {
    pub motion: bool,
    /// Effects that need motion.
    pub temporal_color: bool,
    pub rigid: bool,
}

impl Switches {
    pub(crate) fn new(effects: &Effects) -> Self {
        let motion = effects.has("motion");
        Self { motion, temporal_color: motion && effects.has("temporal-color"), rigid: motion && effects.has("rigid") }
    }
}

/// Why `temporal-color` is on where it is inert.
const LIGHT: &str = "part of the published model; it serves scenes whose light changes, which the synthetic scenes do not have, \
                     and `effects = [\"-temporal-color\"]` switches it off";

/// The method's effects, in the order of its README.
pub(crate) fn effects() -> Vec<Effect> {
    let motion = Effect::new("motion", "Gaussians have a time, move, rotate and fade", &[Need::Times(2), Need::Motion]);
    const OF_MOTION: &[Need] = &[Need::Effect("motion")];
    vec![
        motion,
        Effect::new("temporal-color", "colours change with time", OF_MOTION).stays(LIGHT),
        Effect::new("rigid", "neighbours move alike", OF_MOTION).off_by_default(),
        SEED_FROM_MASKS,
    ]
}
