//! Spherical linear interpolation.

use super::{four, wgsl_of};
use crate::arrays::rows::{RowMap, RowWgsl, map_rows};
use crate::geometry::algebra::{Quaternion, combine4, dot4, normalised, normalised_backward};
use crate::tape::{Real, Tape, Var};

/// Cosine of the half angle above which the arc is as good as its chord: they differ by less than 10⁻⁶, and the sine of
/// the angle, by which the arc's weights are divided, stays above 0.03.
pub(super) const CHORD_ABOVE: f64 = 0.9995;

/// From the direction of a [N, 4] to that of b [N, 4] by the share t [N, 1], along the shorter arc: unit quaternions [N, 4].
///
/// With θ the angle between a and ±b: (sin((1 − t)θ)·a ± sin(tθ)·b) / sin θ; where θ is small, the normalised chord.
pub fn slerp<T: Real>(tape: &mut Tape<T>, a: Var, b: Var, t: Var) -> Var {
    map_rows(tape, Slerp, [a, b, t])
}

struct Slerp;

impl RowMap<3> for Slerp {
    const NAME: &'static str = "slerp";

    fn output_columns(&self, columns: [usize; 3]) -> usize {
        assert_eq!(columns, [4, 4, 1], "slerp: rows of four, of four and of one");
        4
    }

    fn value<T: Real>(&self, [a, b, t]: [&[T]; 3], y: &mut [T]) {
        let arc = Arc::new(four(a), four(b));
        let weights = arc.weights(t[0]);
        y.copy_from_slice(&normalised(combine4(weights.a, arc.a, weights.b, arc.b)).0);
    }

    fn gradient<T: Real>(&self, [a, b, t]: [&[T]; 3], _y: &[T], dy: &[T], [da, db, dt]: [&mut [T]; 3]) {
        let arc = Arc::new(four(a), four(b));
        let weights = arc.weights(t[0]);
        // On the arc the sum has unit length already; dividing by it then changes neither value nor tangential gradient.
        let (unit, inverse_norm) = normalised(combine4(weights.a, arc.a, weights.b, arc.b));
        let dsum = normalised_backward(unit, inverse_norm, four(dy));
        let (along_a, along_b) = (dot4(dsum, arc.a), dot4(dsum, arc.b));
        let dcosine = along_a * weights.a_by_cosine + along_b * weights.b_by_cosine;
        let d_unit_a = combine4(weights.a, dsum, dcosine, arc.b);
        let d_unit_b = combine4(weights.b, dsum, dcosine, arc.a).map(|value| arc.sign * value);
        da.copy_from_slice(&normalised_backward(arc.a, arc.inverse_norms[0], d_unit_a));
        let unit_b = arc.b.map(|value| arc.sign * value);
        db.copy_from_slice(&normalised_backward(unit_b, arc.inverse_norms[1], d_unit_b));
        dt[0] = along_a * weights.a_by_t + along_b * weights.b_by_t;
    }

    fn wgsl(&self, _columns: [usize; 3]) -> Option<RowWgsl> {
        wgsl_of(include_str!("slerp.wgsl"), include_str!("slerp_bwd.wgsl"))
    }
}

/// The ends of an arc: unit quaternions, b turned to the side of a.
struct Arc<T> {
    a: Quaternion<T>,
    b: Quaternion<T>,
    /// −1 where b was turned.
    sign: T,
    inverse_norms: [T; 2],
    /// The cosine of the angle between a and b, in [0, 1].
    cosine: T,
}

/// The weights of both ends and their derivatives by the cosine and by t.
struct Weights<T> {
    a: T,
    b: T,
    a_by_cosine: T,
    b_by_cosine: T,
    a_by_t: T,
    b_by_t: T,
}

impl<T: Real> Arc<T> {
    fn new(a: Quaternion<T>, b: Quaternion<T>) -> Self {
        let ((a, inverse_norm_a), (b, inverse_norm_b)) = (normalised(a), normalised(b));
        let cosine = dot4(a, b);
        let sign = if cosine < T::ZERO { -T::ONE } else { T::ONE };
        let b = b.map(|value| sign * value);
        Self { a, b, sign, inverse_norms: [inverse_norm_a, inverse_norm_b], cosine: sign * cosine }
    }

    fn weights(&self, t: T) -> Weights<T> {
        if self.cosine > T::from_f64(CHORD_ABOVE) {
            let (a, b) = (T::ONE - t, t);
            return Weights { a, b, a_by_cosine: T::ZERO, b_by_cosine: T::ZERO, a_by_t: -T::ONE, b_by_t: T::ONE };
        }
        let angle = self.cosine.acos();
        let sine = angle.sin();
        // sin(sθ)/sin θ and its derivative by θ, divided by dcos θ/dθ = −sin θ.
        let weight = |share: T| (share * angle).sin() / sine;
        let by_cosine = |share: T| {
            let cosine_of_share = (share * angle).cos();
            -(share * cosine_of_share - weight(share) * self.cosine) / (sine * sine)
        };
        let by_share = |share: T| angle * (share * angle).cos() / sine;
        Weights {
            a: weight(T::ONE - t),
            b: weight(t),
            a_by_cosine: by_cosine(T::ONE - t),
            b_by_cosine: by_cosine(t),
            a_by_t: -by_share(T::ONE - t),
            b_by_t: by_share(t),
        }
    }
}

#[cfg(test)]
pub(super) fn validate_slerp() {
    crate::arrays::rows::validate_map(&Slerp, [4, 4, 1]);
}
