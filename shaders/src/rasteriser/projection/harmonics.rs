//! Real spherical harmonics up to degree 3 in the order and with the signs of Kerbl et al. 2023.

use crate::geometry::algebra::Vec3;
use crate::tape::Real;

/// Coefficients of degree 3.
pub(crate) const MAX_COEFFICIENTS: usize = 16;

const C0: f64 = 0.28209479177387814;
const C1: f64 = 0.4886025119029199;
const C2: [f64; 5] =
    [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const C3: [f64; 7] = [
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
];

/// Coefficients per channel of a degree.
pub(crate) fn coefficient_count(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// The basis functions of `degree` at a unit direction; the rest of the array is zero.
#[inline(always)]
pub(crate) fn basis<T: Real>(degree: usize, [x, y, z]: Vec3<T>) -> [T; MAX_COEFFICIENTS] {
    let f = T::from_f64;
    let mut b = [T::ZERO; MAX_COEFFICIENTS];
    b[0] = f(C0);
    if degree >= 1 {
        b[1] = -f(C1) * y;
        b[2] = f(C1) * z;
        b[3] = -f(C1) * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = f(C2[0]) * x * y;
        b[5] = f(C2[1]) * y * z;
        b[6] = f(C2[2]) * (f(2.0) * zz - xx - yy);
        b[7] = f(C2[3]) * x * z;
        b[8] = f(C2[4]) * (xx - yy);
    }
    if degree >= 3 {
        b[9] = f(C3[0]) * y * (f(3.0) * xx - yy);
        b[10] = f(C3[1]) * x * y * z;
        b[11] = f(C3[2]) * y * (f(4.0) * zz - xx - yy);
        b[12] = f(C3[3]) * z * (f(2.0) * zz - f(3.0) * (xx + yy));
        b[13] = f(C3[4]) * x * (f(4.0) * zz - xx - yy);
        b[14] = f(C3[5]) * z * (xx - yy);
        b[15] = f(C3[6]) * x * (xx - f(3.0) * yy);
    }
    b
}

/// Σₖ gₖ ∇Yₖ(direction), with the direction's components taken as independent.
#[inline(always)]
pub(crate) fn basis_backward<T: Real>(degree: usize, [x, y, z]: Vec3<T>, g: &[T; MAX_COEFFICIENTS]) -> Vec3<T> {
    let f = T::from_f64;
    let (mut dx, mut dy, mut dz) = (T::ZERO, T::ZERO, T::ZERO);
    if degree >= 1 {
        dx = -f(C1) * g[3];
        dy = -f(C1) * g[1];
        dz = f(C1) * g[2];
    }
    if degree >= 2 {
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|i| f(C2[i]) * g[4 + i]);
        let two = f(2.0);
        dx += a * y - two * c * x + d * z + two * e * x;
        dy += a * x + b * z - two * c * y - two * e * y;
        dz += b * y + f(4.0) * c * z + d * x;
    }
    if degree >= 3 {
        let [a, b, c, d, e, h, k] = [0, 1, 2, 3, 4, 5, 6].map(|i| f(C3[i]) * g[9 + i]);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (two, three, four, six, eight) = (f(2.0), f(3.0), f(4.0), f(6.0), f(8.0));
        dx += six * a * x * y + b * y * z - two * c * x * y - six * d * x * z
            + e * (four * zz - three * xx - yy)
            + two * h * x * z
            + three * k * (xx - yy);
        dy += three * a * (xx - yy) + b * x * z + c * (four * zz - xx - three * yy)
            - six * d * y * z
            - two * e * x * y
            - two * h * y * z
            - six * k * x * y;
        dz += b * x * y + eight * c * y * z + three * d * (two * zz - xx - yy) + eight * e * x * z + h * (xx - yy);
    }
    [dx, dy, dz]
}
