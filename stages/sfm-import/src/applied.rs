//! nerfstudio's `applied_transform` and `applied_scale`: the transform from the original world to the frame of the poses.

use glam::{DMat3, DMat4, DVec3};
use scene::RigidTransform;

use crate::error::{Result, bad};

/// A similarity transform: applied = scale · (rotation · original) + translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Applied {
    scale: f64,
    rotation: DMat3,
    translation: DVec3,
}

impl Applied {
    /// Nothing was applied.
    pub(crate) const IDENTITY: Self = Self { scale: 1.0, rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// The transform, then the scale. A transform that is not a similarity is an error.
    pub(crate) fn of(transform: Option<&[[f64; 4]]>, scale: Option<f64>) -> Result<Self> {
        let scale = scale.unwrap_or(1.0);
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(bad(format!("applied_scale is {scale}, but must be positive and finite")));
        }
        let Some(rows) = transform else { return Ok(Self { scale, ..Self::IDENTITY }) };
        let refuse =
            |why: String| bad(format!("applied_transform {why}")).hint("export the poses again, or remove the key");
        let matrix = affine(rows).ok_or_else(|| refuse(format!("has {} rows instead of 3", rows.len())))?;
        let own_scale = DMat3::from_mat4(matrix).determinant().abs().cbrt();
        if !(own_scale > 0.0 && own_scale.is_finite()) {
            return Err(refuse("cannot be undone: its determinant is 0".into()));
        }
        let unscaled = matrix * DMat4::from_scale(DVec3::splat(own_scale.recip()));
        let rigid = RigidTransform::from_matrix(unscaled);
        rigid.check().map_err(|error| refuse(format!("is not a similarity: {}", error.message)))?;
        Ok(Self { scale: scale * own_scale, rotation: rigid.rotation, translation: scale * rigid.translation })
    }

    /// Whether poses are in the original world.
    pub(crate) fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// A point of the original world.
    pub(crate) fn undo(&self, point: DVec3) -> DVec3 {
        self.rotation.transpose() * ((point - self.translation) / self.scale)
    }

    /// A camera-to-world transform of the original world.
    pub(crate) fn undo_pose(&self, pose: &RigidTransform) -> RigidTransform {
        RigidTransform { rotation: self.rotation.transpose() * pose.rotation, translation: self.undo(pose.translation) }
    }
}

/// The rows of an affine matrix, of which the last may be omitted; `None` for another number of rows.
pub(crate) fn affine(rows: &[[f64; 4]]) -> Option<DMat4> {
    let rows: [[f64; 4]; 4] = match *rows {
        [x, y, z] => [x, y, z, [0.0, 0.0, 0.0, 1.0]],
        [x, y, z, w] => [x, y, z, w],
        _ => return None,
    };
    Some(DMat4::from_cols_array_2d(&rows).transpose())
}
