use super::matrix::Matrix;

/// out = lhs·rhs, row-major, on one thread, so that the result does not depend on the number of threads.
pub(super) fn multiply(lhs: Matrix<f32>, rhs: Matrix<f32>, out: &mut [f32]) {
    assert_eq!(lhs.columns, rhs.rows, "inner dimensions differ");
    assert_eq!(out.len(), lhs.rows * rhs.columns, "output of the wrong size");
    if lhs.columns == 0 {
        return out.fill(0.0);
    }
    // SAFETY: a `Matrix` covers exactly rows × columns elements of its slice with its strides, `out` has the asserted
    // size and is exclusively borrowed, and all three outlive the call.
    unsafe {
        gemm::gemm(
            lhs.rows,
            rhs.columns,
            lhs.columns,
            out.as_mut_ptr(),
            1,
            rhs.columns as isize,
            false,
            lhs.data.as_ptr(),
            lhs.column_stride as isize,
            lhs.row_stride as isize,
            rhs.data.as_ptr(),
            rhs.column_stride as isize,
            rhs.row_stride as isize,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}
