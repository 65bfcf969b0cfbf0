//! Rearranging, reducing and combining the rows of [N, …] tensors.
//!
//! The operations between large kernels: concatenate and slice columns, gather rows, sum rows by owner, norms and products
//! of rows. Row-wise functions use `map_rows`; data moves between rows through [`RowIndex`], whose order of summation is
//! fixed, so no result depends on the number of threads.

mod arrange;
#[cfg(test)]
mod gpu_tests;
mod index;
mod keep;
mod map;
mod median;
mod reduce;
#[cfg(test)]
mod tests;
mod unit_box;
mod weighted_mean;

pub use arrange::{columns, concat_columns, concat_leading_columns, concat_rows, repeat_row, reshape};
pub use index::{RowIndex, gather, segment_mean, segment_sum};
pub use keep::keep_rows;
#[cfg(test)]
pub(crate) use map::validate_map;
pub(crate) use map::{RowMap, RowWgsl, map_rows};
pub use median::median_where;
pub use reduce::{cosine_distance, divide_rows, norm, normalize, row_dot, row_sum, scale_rows, squared_norm};
pub use unit_box::in_unit_box;
pub use weighted_mean::weighted_mean_squared_difference;

/// The shape with another number of rows.
fn with_rows(shape: &[usize], rows: usize) -> Vec<usize> {
    let mut shape = shape.to_vec();
    shape[0] = rows;
    shape
}
