//! The operations between the large kernels: rows, sums, sorting and sampling.

pub mod bytes;
pub mod magnitude;
pub mod rows;
pub mod sample;
pub(crate) mod sort;
pub(crate) mod sums;
pub mod totals;
