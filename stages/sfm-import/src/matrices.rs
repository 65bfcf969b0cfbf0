//! Matrices of lenses and poses from numbers in files, row by row.

use glam::{DMat3, DMat4, DQuat, DVec4};
use scene::{Intrinsics, RigidTransform};

use crate::error::{Result, bad};

/// Largest deviation of a quaternion's length from 1: above the rounding error of four printed digits.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// Largest deviation of a rotation from orthonormality that is due to rounding, e.g. to three decimals.
const ROUNDED: f64 = 5e-3;

/// A pinhole of this size from the rows of its matrix.
pub(crate) fn pinhole(rows: &[f64], (width, height): (u32, u32)) -> Intrinsics {
    Intrinsics { width, height, focal_x: rows[0], focal_y: rows[4], center_x: rows[2], center_y: rows[5] }
}

/// A rigid transform from the three rows of its matrix.
pub(crate) fn transform(rows: &[f64]) -> RigidTransform {
    let row = |at: usize| DVec4::from_slice(&rows[4 * at..]);
    RigidTransform::from_matrix(DMat4::from_cols(row(0), row(1), row(2), DVec4::W).transpose())
}

/// Whether the rotation is not orthonormal, but no further from it than by rounding.
pub(crate) fn is_rounded(transform: &RigidTransform) -> bool {
    transform.check().is_err() && transform.deviation() <= ROUNDED
}

/// The nearest rotation to a matrix with errors of single precision; a matrix that is not a rotation is left unchanged.
pub(crate) fn straightened(transform: RigidTransform) -> RigidTransform {
    let rotation = transform.rotation;
    let [x, y] = [rotation.x_axis.normalize_or_zero(), rotation.y_axis.normalize_or_zero()];
    let z = x.cross(y).normalize_or_zero();
    let straight = DMat3::from_cols(x, z.cross(x), z);
    let is_near = (straight - rotation).to_cols_array().iter().all(|difference| difference.abs() < 1e-2);
    if is_near { RigidTransform { rotation: straight, ..transform } } else { transform }
}

/// The rotation of a quaternion in a line of a file; an error for any length but 1.
pub(crate) fn rotation(quaternion: DQuat, line: usize) -> Result<DMat3> {
    let length = quaternion.length();
    if !((length - 1.0).abs() <= LENGTH_TOLERANCE) {
        let hint = "check the order of the columns, or divide the four numbers of the quaternion by its length";
        return Err(bad(format!("line {line}: the quaternion has the length {length} instead of 1")).hint(hint));
    }
    Ok(DMat3::from_quat(quaternion.normalize()))
}
