use crate::tape::Real;

/// A view of a slice as a dense matrix, row-major or transposed.
#[derive(Copy, Clone)]
pub(crate) struct Matrix<'a, T> {
    pub data: &'a [T],
    pub rows: usize,
    pub columns: usize,
    pub(crate) row_stride: usize,
    pub(crate) column_stride: usize,
}

impl<'a, T: Real> Matrix<'a, T> {
    /// A row-major matrix.
    pub(crate) fn new(data: &'a [T], columns: usize) -> Self {
        assert_eq!(data.len() % columns, 0, "matrix with an incomplete row");
        Self { data, rows: data.len() / columns, columns, row_stride: columns, column_stride: 1 }
    }

    pub(crate) fn transposed(self) -> Self {
        Self {
            data: self.data,
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
        }
    }

    pub(crate) fn at(&self, row: usize, column: usize) -> T {
        self.data[row * self.row_stride + column * self.column_stride]
    }

    pub(crate) fn as_f32(self) -> Option<Matrix<'a, f32>> {
        let Self { rows, columns, row_stride, column_stride, .. } = self;
        T::as_f32(self.data).map(|data| Matrix { data, rows, columns, row_stride, column_stride })
    }
}
