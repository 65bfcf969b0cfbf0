//! The covariance of a splat as FFᵀ, and the factor F from its parameters.

use crate::geometry::algebra::{
    Mat3, Vec3, column, dot, normalised, normalised_backward, rotation, rotation_backward, scale_columns,
};
use crate::tape::Real;

/// Standard deviations above this, in scene units, are about to overflow.
const MAX_SCALE: f64 = 1e9;

/// The parameters of a splat's covariance; also the type of their gradients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape<T> {
    /// F = R_q·diag(eˢ): logarithms of the standard deviations, and a quaternion (w, x, y, z) of any length.
    ScaleRotation { log_scales: Vec3<T>, rotation: [T; 4] },
    /// F itself, rows along the world's axes.
    Factor(Mat3<T>),
}

impl<T: Real> Shape<T> {
    /// Whether all values that affect the image are finite; a quaternion without direction is replaced by the identity.
    #[inline(always)]
    pub(super) fn is_finite(&self) -> bool {
        match self {
            Self::ScaleRotation { rotation, .. } => rotation.iter().all(|value| value.is_finite()),
            Self::Factor(factor) => factor.iter().flatten().all(|value| value.is_finite()),
        }
    }
}

/// F, with the intermediates of its backward pass.
pub(super) struct Factor<T> {
    /// Rows along the world's axes.
    pub matrix: Mat3<T>,
    source: Source<T>,
}

enum Source<T> {
    /// Unit quaternion and 1/|q| (zero where the rotation is undefined), standard deviations, rotation.
    ScaleRotation {
        quaternion: [T; 4],
        inverse_norm: T,
        scales: Vec3<T>,
        rotation: Mat3<T>,
    },
    Given,
}

impl<T: Real> Factor<T> {
    /// `None` if a standard deviation is extreme or NaN.
    #[inline(always)]
    pub(super) fn new(shape: &Shape<T>) -> Option<Self> {
        let limit = T::from_f64(MAX_SCALE);
        match *shape {
            Shape::ScaleRotation { log_scales, rotation: raw } => {
                let scales = log_scales.map(T::exp);
                if !scales.iter().all(|&scale| scale <= limit) {
                    return None;
                }
                let (quaternion, inverse_norm) = normalised(raw);
                let rotation = rotation(quaternion);
                let source = Source::ScaleRotation { quaternion, inverse_norm, scales, rotation };
                Some(Self { matrix: scale_columns(&rotation, scales), source })
            }
            Shape::Factor(matrix) => {
                let in_range = matrix.iter().flatten().all(|value| value.abs() <= limit);
                in_range.then_some(Self { matrix, source: Source::Given })
            }
        }
    }

    /// The gradient of the shape's parameters from that of F.
    #[inline(always)]
    pub(super) fn backward(&self, g_factor: &Mat3<T>) -> Shape<T> {
        match &self.source {
            Source::ScaleRotation { quaternion, inverse_norm, scales, rotation } => {
                let along = |axis: usize| scales[axis] * dot(column(rotation, axis), column(g_factor, axis));
                let g_unit = rotation_backward(*quaternion, &scale_columns(g_factor, *scales));
                Shape::ScaleRotation {
                    log_scales: [along(0), along(1), along(2)],
                    rotation: normalised_backward(*quaternion, *inverse_norm, g_unit),
                }
            }
            Source::Given => Shape::Factor(*g_factor),
        }
    }
}
