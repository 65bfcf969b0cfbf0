//! 4-vectors (x, y, z, t) and the rotations of four dimensions over a generic scalar.

use crate::geometry::algebra::{combine4, dot4};
use crate::tape::Real;

pub(super) type Vec4<T> = [T; 4];
/// An array of rows.
pub(crate) type Mat4<T> = [[T; 4]; 4];

/// The part of `g` tangential to the unit vector `unit`, divided by the length: the gradient of v from that of v/|v|.
#[inline(always)]
pub(crate) fn direction_backward<T: Real>(unit: Vec4<T>, inverse_length: T, g: Vec4<T>) -> Vec4<T> {
    combine4(inverse_length, g, -dot4(g, unit) * inverse_length, unit)
}

#[inline(always)]
pub(super) fn transposed<T: Real>(m: &Mat4<T>) -> Mat4<T> {
    [0, 1, 2, 3].map(|column| [0, 1, 2, 3].map(|row: usize| m[row][column]))
}

/// a·b.
#[inline(always)]
pub(super) fn product<T: Real>(a: &Mat4<T>, b: &Mat4<T>) -> Mat4<T> {
    let columns = transposed(b);
    a.map(|row| columns.map(|column| dot4(row, column)))
}

/// p ↦ q ⊗ p for p = t + xi + yj + zk and q = (w, x, y, z).
#[inline(always)]
pub(super) fn left<T: Real>([w, x, y, z]: Vec4<T>) -> Mat4<T> {
    [[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]
}

/// p ↦ p ⊗ q̄.
#[inline(always)]
pub(super) fn right<T: Real>([w, x, y, z]: Vec4<T>) -> Mat4<T> {
    [[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z], [x, y, z, w]]
}

/// The gradient of q from that of [`left`].
#[inline(always)]
pub(crate) fn left_backward<T: Real>(g: &Mat4<T>) -> Vec4<T> {
    [
        g[0][0] + g[1][1] + g[2][2] + g[3][3],
        g[0][3] - g[1][2] + g[2][1] - g[3][0],
        g[0][2] + g[1][3] - g[2][0] - g[3][1],
        g[1][0] - g[0][1] + g[2][3] - g[3][2],
    ]
}

/// The gradient of q from that of [`right`].
#[inline(always)]
pub(crate) fn right_backward<T: Real>(g: &Mat4<T>) -> Vec4<T> {
    [
        g[0][0] + g[1][1] + g[2][2] + g[3][3],
        g[2][1] - g[0][3] - g[1][2] + g[3][0],
        g[0][2] - g[1][3] - g[2][0] + g[3][1],
        g[1][0] - g[0][1] - g[2][3] + g[3][2],
    ]
}
