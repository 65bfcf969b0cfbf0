use super::matrix::Matrix;
use crate::tape::Real;

/// out = lhs·rhs, row-major.
pub(super) fn multiply<T: Real>(lhs: Matrix<T>, rhs: Matrix<T>, out: &mut [T]) {
    for row in 0..lhs.rows {
        for column in 0..rhs.columns {
            out[row * rhs.columns + column] = (0..lhs.columns).map(|k| lhs.at(row, k) * rhs.at(k, column)).sum();
        }
    }
}
