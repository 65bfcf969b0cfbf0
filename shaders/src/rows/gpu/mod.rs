//! The kernels of row operations.

pub mod arrange;
mod index;
mod map;
pub mod median;
pub mod normalize;
pub mod weighted_mean;

pub(crate) use index::GpuIndex;
#[cfg(test)]
pub(crate) use map::validate_map;
pub use map::{RowKernel, RowWgsl};

use super::index::with_rows;
