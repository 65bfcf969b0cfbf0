//! The motion of nodes, as both branches represent it.

use shaders::tape::Var;

/// Prefix of the direct branch's network tensors.
pub(crate) const NETWORK: &str = "network";

/// Motion of M nodes relative to the canonical nodes at T times, stored time by time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeMotion {
    /// Translations [T·M, 3], scene units.
    pub translations: Var,
    /// Rotations [T·M, 4], unit quaternions.
    pub rotations: Var,
}

/// Predictions of both branches for the same nodes and times.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Predictions {
    /// From position and time alone (equations 8 and 9).
    pub direct: NodeMotion,
    /// From the previous states (equation 5).
    pub chained: NodeMotion,
}

impl Predictions {
    /// Applies `f` to every tensor.
    pub(crate) fn map(&self, mut f: impl FnMut(Var) -> Var) -> Self {
        let mut both = |NodeMotion { translations, rotations }| NodeMotion {
            translations: f(translations),
            rotations: f(rotations),
        };
        Self { direct: both(self.direct), chained: both(self.chained) }
    }
}
