//! Rows drawn at random without replacement, from those that may be drawn: on a GPU nobody waits to learn which and how many.
//!
//! Every row has a number that hangs on its index and a seed alone; those with the smallest numbers are drawn. So both
//! devices draw the same rows in the same order.

mod gpu;
#[cfg(test)]
mod tests;

use crate::arrays::rows::RowIndex;
use crate::tape::{Device, Real, Tensor};

/// How many rows are drawn: ⌈share · candidates⌉, at most `most`.
#[derive(Clone, Copy, Debug)]
pub struct SampleSize {
    /// In (0, 1].
    pub share: f64,
    pub most: usize,
}

/// M of N rows, in the order in which they were drawn.
#[derive(Clone, Debug)]
pub struct SampledRows<T: Real> {
    /// Each another row.
    pub rows: RowIndex,
    /// [M]: 1 for a row that was drawn. 0 for one that stands in a place that is left over, as a GPU has as many places as
    /// if all rows could be drawn; on the CPU there are none of these.
    pub weights: Tensor<T>,
}

impl SampleSize {
    /// Rows drawn from so many: in f32, as a GPU computes it.
    fn of(self, candidates: usize) -> usize {
        let share = (self.share as f32 * candidates as f32).ceil() as usize;
        share.min(self.most).min(candidates)
    }
}

/// Draws from the rows whose flag in `candidates` [N] is above 0.
pub fn sample_rows<T: Real>(device: Device, candidates: &Tensor<T>, size: SampleSize, seed: u32) -> SampledRows<T> {
    match device {
        Device::Cpu => sample_on_host(candidates, size, seed),
        Device::Gpu(gpu) => gpu::sample(gpu, candidates, size, seed),
    }
}

fn sample_on_host<T: Real>(candidates: &Tensor<T>, size: SampleSize, seed: u32) -> SampledRows<T> {
    let flags = candidates.as_slice().iter().enumerate();
    let mut rows: Vec<u32> = flags.filter(|(_, flag)| **flag > T::ZERO).map(|(row, _)| row as u32).collect();
    let (count, key) = (size.of(rows.len()), |row: &u32| (key(*row, seed), *row));
    if count < rows.len() {
        rows.select_nth_unstable_by_key(count, key);
        rows.truncate(count);
    }
    rows.sort_unstable_by_key(key);
    SampledRows { rows: RowIndex::new(rows, candidates.len()), weights: Tensor::full([count], T::ONE) }
}

/// The number of a row, below 2³¹.
fn key(row: u32, seed: u32) -> u32 {
    scrambled(scrambled(row) ^ seed) >> 1
}

/// The finaliser of MurmurHash3 (Appleby 2011): a bijection after which every bit hangs on all bits of the input.
fn scrambled(mut bits: u32) -> u32 {
    bits = (bits ^ (bits >> 16)).wrapping_mul(0x85eb_ca6b);
    bits = (bits ^ (bits >> 13)).wrapping_mul(0xc2b2_ae35);
    bits ^ (bits >> 16)
}
