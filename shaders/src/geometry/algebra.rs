//! 3-vectors, 3×3 matrices (arrays of rows) and quaternions (w, x, y, z) over a generic scalar.

use crate::tape::Real;

/// Quaternions shorter than the root of this count as no rotation: their direction is rounding noise.
const MIN_SQUARED_NORM: f64 = 1e-12;

pub(crate) type Vec3<T> = [T; 3];
pub(crate) type Mat3<T> = [[T; 3]; 3];
pub(crate) type Quaternion<T> = [T; 4];

#[inline(always)]
pub(crate) fn dot<T: Real>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// x·a + y·b.
#[inline(always)]
pub(crate) fn combine<T: Real>(x: T, a: Vec3<T>, y: T, b: Vec3<T>) -> Vec3<T> {
    [x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]]
}

#[inline(always)]
pub(crate) fn column<T: Real>(m: &Mat3<T>, index: usize) -> Vec3<T> {
    [m[0][index], m[1][index], m[2][index]]
}

#[inline(always)]
pub(crate) fn transposed<T: Real>(m: &Mat3<T>) -> Mat3<T> {
    [column(m, 0), column(m, 1), column(m, 2)]
}

#[inline(always)]
pub(crate) fn apply<T: Real>(m: &Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// a·b.
#[inline(always)]
pub(crate) fn product<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let columns = transposed(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

/// m·diag(s).
#[inline(always)]
pub(crate) fn scale_columns<T: Real>(m: &Mat3<T>, s: Vec3<T>) -> Mat3<T> {
    m.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]])
}

/// The rotation of a unit quaternion (w, x, y, z).
#[inline(always)]
pub(crate) fn rotation<T: Real>([w, x, y, z]: Quaternion<T>) -> Mat3<T> {
    let (one, two) = (T::ONE, T::from_f64(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// The gradient of a unit quaternion from that of its [`rotation`], before projection to the tangent space.
#[inline(always)]
pub(crate) fn rotation_backward<T: Real>([w, x, y, z]: Quaternion<T>, g: &Mat3<T>) -> Quaternion<T> {
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

/// The unit quaternion and 1/|q|, or the identity and zero where q has no direction; a NaN stays a NaN.
#[inline(always)]
pub(crate) fn normalised<T: Real>(q: Quaternion<T>) -> (Quaternion<T>, T) {
    let squared = dot4(q, q);
    if squared < T::from_f64(MIN_SQUARED_NORM) {
        return ([T::ONE, T::ZERO, T::ZERO, T::ZERO], T::ZERO);
    }
    let inverse_norm = T::ONE / squared.sqrt();
    (q.map(|value| value * inverse_norm), inverse_norm)
}

/// The gradient of q from that of its [`normalised`] form: only the part tangential to the sphere of directions.
#[inline(always)]
pub(crate) fn normalised_backward<T: Real>(unit: Quaternion<T>, inverse_norm: T, g: Quaternion<T>) -> Quaternion<T> {
    let radial = dot4(g, unit);
    [0, 1, 2, 3].map(|i| (g[i] - radial * unit[i]) * inverse_norm)
}

#[inline(always)]
pub(crate) fn dot4<T: Real>(a: Quaternion<T>, b: Quaternion<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// x·a + y·b.
#[inline(always)]
pub(crate) fn combine4<T: Real>(x: T, a: Quaternion<T>, y: T, b: Quaternion<T>) -> Quaternion<T> {
    [0, 1, 2, 3].map(|i| x * a[i] + y * b[i])
}

/// Hamilton's product p⊗q: the rotation q followed by p.
#[inline(always)]
pub(crate) fn hamilton<T: Real>(p: Quaternion<T>, q: Quaternion<T>) -> Quaternion<T> {
    [
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    ]
}

#[inline(always)]
pub(crate) fn conjugate<T: Real>([w, x, y, z]: Quaternion<T>) -> Quaternion<T> {
    [w, -x, -y, -z]
}
