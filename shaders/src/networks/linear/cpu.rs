use super::matrix::Matrix;

/// out = lhs·rhs, row-major, on one thread, so that the result does not depend on the number of threads.
pub(super) fn multiply(lhs: Matrix<f32>, rhs: Matrix<f32>, out: &mut [f32]) {
    assert_eq!(lhs.columns, rhs.rows, "inner dimensions differ");
    assert_eq!(out.len(), lhs.rows * rhs.columns, "output of the wrong size");
    if lhs.columns == 0 {
        return out.fill(0.0);
    }
    // The kernel prefers columns of its output in memory: outᵀ = rhsᵀ·lhsᵀ. An output of one column has them as it is.
    let (first, second) = if rhs.columns > 1 { (rhs.transposed(), lhs.transposed()) } else { (lhs, rhs) };
    // SAFETY: a `Matrix` covers exactly rows × columns elements of its slice with its strides, `out` has the asserted
    // size and is exclusively borrowed, and all three outlive the call.
    unsafe {
        gemm_f32::gemm::f32::get_gemm_fn()(
            first.rows,
            second.columns,
            first.columns,
            out.as_mut_ptr(),
            rhs.columns as isize,
            1,
            false,
            first.data.as_ptr(),
            first.column_stride as isize,
            first.row_stride as isize,
            second.data.as_ptr(),
            second.column_stride as isize,
            second.row_stride as isize,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm_common::Parallelism::None,
        );
    }
}
