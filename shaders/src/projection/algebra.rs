//! 3-vectors and 3×3 matrices (arrays of rows) over a generic scalar.

use crate::tape::Real;

pub type Vec3<T> = [T; 3];
pub type Mat3<T> = [[T; 3]; 3];

#[inline(always)]
pub fn dot<T: Real>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn cross<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// x·a + y·b.
#[inline(always)]
pub fn combine<T: Real>(x: T, a: Vec3<T>, y: T, b: Vec3<T>) -> Vec3<T> {
    [x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]]
}

#[inline(always)]
pub fn column<T: Real>(m: &Mat3<T>, index: usize) -> Vec3<T> {
    [m[0][index], m[1][index], m[2][index]]
}

#[inline(always)]
pub fn transposed<T: Real>(m: &Mat3<T>) -> Mat3<T> {
    [column(m, 0), column(m, 1), column(m, 2)]
}

#[inline(always)]
pub fn apply<T: Real>(m: &Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// a·b.
#[inline(always)]
pub fn product<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let columns = transposed(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

/// m·diag(s).
#[inline(always)]
pub fn scale_columns<T: Real>(m: &Mat3<T>, s: Vec3<T>) -> Mat3<T> {
    m.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]])
}

/// The rotation of a unit quaternion (w, x, y, z).
#[inline(always)]
pub fn rotation<T: Real>([w, x, y, z]: [T; 4]) -> Mat3<T> {
    let (one, two) = (T::ONE, T::from_f64(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// The gradient of a unit quaternion from that of its [`rotation`], before projection to the tangent space.
#[inline(always)]
pub fn rotation_backward<T: Real>([w, x, y, z]: [T; 4], g: &Mat3<T>) -> [T; 4] {
    let two = T::from_f64(2.0);
    let (wx, wy, wz) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (xy, xz, yz) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    [
        two * (x * wx + y * wy + z * wz),
        two * (y * xy + z * xz + w * wx - two * x * (g[1][1] + g[2][2])),
        two * (x * xy + z * yz + w * wy - two * y * (g[0][0] + g[2][2])),
        two * (x * xz + y * yz + w * wz - two * z * (g[0][0] + g[1][1])),
    ]
}
