//! Spherical harmonics up to the degree in use. Constant and higher coefficients are stored separately, because their
//! learning rates differ.

use shaders::arrays::rows::{columns, concat_leading_columns, reshape};
use shaders::tape::{Real, Tape, Var};

/// Joins constant [N, 1, 3] and higher coefficients [N, R, 3] to [N, (degree + 1)², 3].
pub(crate) fn active_harmonics<T: Real>(tape: &mut Tape<T>, sh_dc: Var, sh_rest: Var, degree: usize) -> Var {
    let rest = (degree + 1).pow(2) - 1;
    let (count, stored) = (tape.value(sh_rest).rows(), tape.value(sh_rest).shape()[1]);
    assert!(rest <= stored, "degree {degree} needs {rest} higher harmonics, the model stores {stored}");
    if rest == 0 {
        return sh_dc;
    }
    let joined = concat_leading_columns(tape, &[(sh_dc, 3), (sh_rest, 3 * rest)]);
    reshape(tape, joined, [count, 1 + rest, 3])
}

/// The first (degree + 1)² of K coefficients: [N, 3·K] to [N, (degree + 1)², 3].
pub(crate) fn leading_harmonics<T: Real>(tape: &mut Tape<T>, rows: Var, degree: usize) -> Var {
    let (count, leading) = (tape.value(rows).rows(), (degree + 1).pow(2));
    let leading_columns = columns(tape, rows, 0..3 * leading);
    reshape(tape, leading_columns, [count, leading, 3])
}
