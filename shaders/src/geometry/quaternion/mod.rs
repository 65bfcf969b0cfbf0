//! Rotations as quaternions (w, x, y, z), row by row: [N, 4].
//!
//! A quaternion shorter than 10⁻⁶ has no direction: it counts as the identity and has gradient 0, here as in
//! [`projection`](crate::rasteriser::projection). [`slerp`] is spherical linear interpolation (Shoemake 1985) along the shorter
//! arc.

mod fit;
#[cfg(test)]
mod gpu_tests;
mod slerp;
#[cfg(test)]
mod tests;

pub use fit::best_rotations;
pub use slerp::slerp;

use crate::arrays::rows::{RowMap, RowWgsl, map_rows};
use crate::geometry::algebra::{
    Quaternion, apply, conjugate, dot4, hamilton, normalised, normalised_backward, rotation, rotation_backward,
    transposed,
};
use crate::tape::{Real, Tape, Var};

/// q / |q| of every row: [N, 4] → [N, 4]; the identity where q has no direction.
pub fn normalize<T: Real>(tape: &mut Tape<T>, q: Var) -> Var {
    map_rows(tape, Normalize, [q])
}

/// Hamilton's product p⊗q of every row, not normalised: [N, 4], [N, 4] → [N, 4]. As rotations: q, then p.
pub fn multiply<T: Real>(tape: &mut Tape<T>, p: Var, q: Var) -> Var {
    map_rows(tape, Multiply, [p, q])
}

/// Vectors v [N, 3] turned by the directions of quaternions q [N, 4] → [N, 3].
pub fn rotate<T: Real>(tape: &mut Tape<T>, q: Var, v: Var) -> Var {
    map_rows(tape, Rotate, [q, v])
}

/// Row by row, q or −q (the same rotation), whichever lies in the hemisphere of `reference`. The reference receives no
/// gradient.
pub fn align<T: Real>(tape: &mut Tape<T>, q: Var, reference: Var) -> Var {
    map_rows(tape, Align, [q, reference])
}

/// The WGSL of a map without constants.
fn wgsl_of(value: &'static str, gradients: &'static str) -> Option<RowWgsl> {
    Some(RowWgsl { value, gradients, specialisation: Vec::new(), numbers: Vec::new() })
}

/// A row of four.
fn four<T: Real>(row: &[T]) -> Quaternion<T> {
    [row[0], row[1], row[2], row[3]]
}

struct Normalize;

impl RowMap<1> for Normalize {
    const NAME: &'static str = "quaternion_normalize";

    fn output_columns(&self, columns: [usize; 1]) -> usize {
        assert_eq!(columns, [4], "quaternion_normalize: rows of four");
        4
    }

    fn value<T: Real>(&self, [q]: [&[T]; 1], y: &mut [T]) {
        y.copy_from_slice(&normalised(four(q)).0);
    }

    fn gradient<T: Real>(&self, [q]: [&[T]; 1], _y: &[T], dy: &[T], [dq]: [&mut [T]; 1]) {
        let (unit, inverse_norm) = normalised(four(q));
        dq.copy_from_slice(&normalised_backward(unit, inverse_norm, four(dy)));
    }

    fn wgsl(&self, _columns: [usize; 1]) -> Option<RowWgsl> {
        wgsl_of(include_str!("normalize.wgsl"), include_str!("normalize_bwd.wgsl"))
    }
}

struct Multiply;

impl RowMap<2> for Multiply {
    const NAME: &'static str = "quaternion_multiply";

    fn output_columns(&self, columns: [usize; 2]) -> usize {
        assert_eq!(columns, [4; 2], "quaternion_multiply: rows of four");
        4
    }

    fn value<T: Real>(&self, [p, q]: [&[T]; 2], y: &mut [T]) {
        y.copy_from_slice(&hamilton(four(p), four(q)));
    }

    /// Multiplication by q is linear; its transpose is multiplication by the conjugate.
    fn gradient<T: Real>(&self, [p, q]: [&[T]; 2], _y: &[T], dy: &[T], [dp, dq]: [&mut [T]; 2]) {
        dp.copy_from_slice(&hamilton(four(dy), conjugate(four(q))));
        dq.copy_from_slice(&hamilton(conjugate(four(p)), four(dy)));
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        wgsl_of(include_str!("multiply.wgsl"), include_str!("multiply_bwd.wgsl"))
    }
}

struct Align;

impl RowMap<2> for Align {
    const NAME: &'static str = "quaternion_align";

    fn output_columns(&self, columns: [usize; 2]) -> usize {
        assert_eq!(columns, [4; 2], "quaternion_align: rows of four");
        4
    }

    fn value<T: Real>(&self, [q, reference]: [&[T]; 2], y: &mut [T]) {
        let sign = side(q, reference);
        y.iter_mut().zip(q).for_each(|(y, &q)| *y = sign * q);
    }

    fn gradient<T: Real>(&self, [q, reference]: [&[T]; 2], _y: &[T], dy: &[T], [dq, _]: [&mut [T]; 2]) {
        let sign = side(q, reference);
        dq.iter_mut().zip(dy).for_each(|(dq, &dy)| *dq = sign * dy);
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        wgsl_of(include_str!("align.wgsl"), include_str!("align_bwd.wgsl"))
    }
}

/// −1 where q points away from the reference, else 1.
fn side<T: Real>(q: &[T], reference: &[T]) -> T {
    if dot4(four(q), four(reference)) < T::ZERO { -T::ONE } else { T::ONE }
}

struct Rotate;

impl RowMap<2> for Rotate {
    const NAME: &'static str = "quaternion_rotate";

    fn output_columns(&self, columns: [usize; 2]) -> usize {
        assert_eq!(columns, [4, 3], "quaternion_rotate: rows of four and of three");
        3
    }

    fn value<T: Real>(&self, [q, v]: [&[T]; 2], y: &mut [T]) {
        y.copy_from_slice(&apply(&rotation(normalised(four(q)).0), [v[0], v[1], v[2]]));
    }

    fn gradient<T: Real>(&self, [q, v]: [&[T]; 2], _y: &[T], dy: &[T], [dq, dv]: [&mut [T]; 2]) {
        let (unit, inverse_norm) = normalised(four(q));
        let matrix_gradient = [0, 1, 2].map(|row| [0, 1, 2].map(|column| dy[row] * v[column]));
        let of_unit = rotation_backward(unit, &matrix_gradient);
        dq.copy_from_slice(&normalised_backward(unit, inverse_norm, of_unit));
        dv.copy_from_slice(&apply(&transposed(&rotation(unit)), [dy[0], dy[1], dy[2]]));
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        wgsl_of(include_str!("rotate.wgsl"), include_str!("rotate_bwd.wgsl"))
    }
}
