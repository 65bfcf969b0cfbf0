//! What a recipe may say about this method.

use serde::{Deserialize, Serialize};

use crate::effects::{Effect, Effects, Need};

/// What only this method understands: the loss of the effect `rigid`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// Its weight.
    pub rigid_weight: f64,
    /// How many Gaussians per view are compared with their neighbours, drawn at random.
    pub rigid_samples: usize,
    /// How many neighbours each has.
    pub rigid_neighbors: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { rigid_weight: 1.0, rigid_samples: 4096, rigid_neighbors: 20 }
    }
}

impl Settings {
    /// Why these settings cannot work, if so.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.rigid_samples == 0 || self.rigid_neighbors == 0 {
            return Err("realtime4dgs: rigid_samples and rigid_neighbors must be positive".into());
        }
        if !(self.rigid_weight >= 0.0 && self.rigid_weight.is_finite()) {
            return Err(format!("realtime4dgs: rigid_weight must not be negative, not {}", self.rigid_weight));
        }
        Ok(())
    }
}

/// Which effects are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Switches {
    pub motion: bool,
    /// These only with motion.
    pub temporal_color: bool,
    pub rigid: bool,
}

impl Switches {
    pub(crate) fn new(effects: &Effects) -> Self {
        let motion = effects.has("motion");
        Self { motion, temporal_color: motion && effects.has("temporal-color"), rigid: motion && effects.has("rigid") }
    }
}

/// What the method can simulate or leave out, in the order of its README.
pub(crate) fn effects() -> Vec<Effect> {
    let motion = Effect {
        name: "motion",
        about: "Gaussians have a time, move, turn and fade",
        needs: &[Need::Times(2), Need::Motion],
        by_default: true,
    };
    let of_motion = |name, about, by_default| Effect { name, about, needs: &[Need::Effect("motion")], by_default };
    vec![
        motion,
        of_motion("temporal-color", "colours change with time", true),
        of_motion("rigid", "neighbours move alike", false),
    ]
}
