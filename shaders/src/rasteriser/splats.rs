//! The parameters of splats.

use crate::tape::{Real, Tape, Tensor, Var};

/// The opacity logit of a splat that is absent at a time: its opacity is far below the visible threshold, so that it is
/// culled, and finite, so that checks for non-finite values pass.
pub const HIDDEN_LOGIT: f64 = -100.0;

/// The parameters of N splats.
#[derive(Clone, Copy, Debug)]
pub struct SplatVars {
    /// [N, 3] world, scene units.
    pub positions: Var,
    /// The parameters of the covariances.
    pub shape: ShapeVars,
    /// [N, 1] or `[N]`, before the logistic function.
    pub opacity_logits: Var,
    /// [N, K, 3] spherical harmonics, K ≥ (degree + 1)².
    pub sh: Var,
}

/// The covariances of N splats.
#[derive(Clone, Copy, Debug)]
pub enum ShapeVars {
    /// R_q·diag(e²ˢ)·R_qᵀ.
    ScaleRotation {
        /// [N, 3] natural logarithm of the standard deviations, scene units.
        log_scales: Var,
        /// [N, 4] quaternions (w, x, y, z), normalised here.
        rotations: Var,
    },
    /// FFᵀ for any F [N, 3, 3], scene units: for shapes without persistent axes, e.g. slices of 4D Gaussians.
    Factor(Var),
}

impl ShapeVars {
    /// Logarithms of the standard deviations and quaternions, where the covariances are given by them.
    pub fn scales_and_rotations(self) -> Option<(Var, Var)> {
        match self {
            Self::ScaleRotation { log_scales, rotations } => Some((log_scales, rotations)),
            Self::Factor(_) => None,
        }
    }
}

/// Parameters of N splats as tensors, with the shapes of [`SplatVars`].
#[derive(Clone, Debug)]
pub struct SplatTensors<T: Real> {
    /// [N, 3]: [`SplatVars::positions`].
    pub positions: Tensor<T>,
    /// [N, 3]: natural logarithms of the standard deviations, scene units.
    pub log_scales: Tensor<T>,
    /// [N, 4]: quaternions (w, x, y, z), normalised by the projection.
    pub rotations: Tensor<T>,
    /// [N, 1]: [`SplatVars::opacity_logits`].
    pub opacity_logits: Tensor<T>,
    /// [N, K, 3]: [`SplatVars::sh`].
    pub sh: Tensor<T>,
}

impl<T: Real> SplatTensors<T> {
    /// The tensors as leaves of a tape.
    pub fn leaves(&self, tape: &mut Tape<T>) -> SplatVars {
        self.vars(|tensor| tape.leaf(tensor))
    }

    /// The tensors as constants of a tape.
    pub fn constants(&self, tape: &mut Tape<T>) -> SplatVars {
        self.vars(|tensor| tape.constant(tensor))
    }

    fn vars(&self, mut var: impl FnMut(Tensor<T>) -> Var) -> SplatVars {
        SplatVars {
            positions: var(self.positions.clone()),
            shape: ShapeVars::ScaleRotation {
                log_scales: var(self.log_scales.clone()),
                rotations: var(self.rotations.clone()),
            },
            opacity_logits: var(self.opacity_logits.clone()),
            sh: var(self.sh.clone()),
        }
    }
}
