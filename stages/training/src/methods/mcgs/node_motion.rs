//! The motion of nodes, as either branch states it.

use shaders::tape::Var;

use crate::data::SceneFacts;

/// The network of the direct branch.
pub(crate) const NETWORK: &str = "network";

/// Changes of nodes against the canonical moment, time by time where there are several.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeMotion {
    /// [T·M, 3], scene units.
    pub translations: Var,
    /// [T·M, 4] unit quaternions.
    pub rotations: Var,
}

/// What both branches say of the same nodes and times.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Predictions {
    /// From where and when alone (equations 8 and 9).
    pub direct: NodeMotion,
    /// From the states before (equation 5).
    pub chained: NodeMotion,
}

impl Predictions {
    /// Every tensor mapped.
    pub(crate) fn map(&self, mut f: impl FnMut(Var) -> Var) -> Self {
        let mut both = |NodeMotion { translations, rotations }| NodeMotion {
            translations: f(translations),
            rotations: f(rotations),
        };
        Self { direct: both(self.direct), chained: both(self.chained) }
    }
}

/// The time from one frame to the next, in shares of the whole time.
pub(crate) fn frame_interval(scene: &SceneFacts) -> f64 {
    1.0 / scene.time_count.saturating_sub(1).max(1) as f64
}
