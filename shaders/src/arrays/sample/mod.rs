//! Random rows, sampled without replacement from the candidates; on a GPU without a readback of their number.
//!
//! Every row has a hash that depends on its index and a seed alone; the rows with the smallest hashes are sampled. Both
//! devices therefore sample the same rows in the same order.

mod gpu;
#[cfg(test)]
mod tests;

use crate::arrays::rows::RowIndex;
use crate::tape::{Device, Real, Tensor};

/// The number of sampled rows: ⌈share · candidates⌉, at most `most`.
#[derive(Clone, Copy, Debug)]
pub struct SampleSize {
    /// In (0, 1].
    pub share: f64,
    /// The upper bound of the number of rows.
    pub most: usize,
}

/// M of N rows, in the order in which they were drawn.
#[derive(Clone, Debug)]
pub struct SampledRows<T: Real> {
    /// Distinct rows.
    pub rows: RowIndex,
    /// `[M]`: 1 for a sampled row, 0 for padding. A GPU pads to the number of rows that would be sampled if all were
    /// candidates; the CPU does not pad.
    pub weights: Tensor<T>,
}

impl SampleSize {
    /// The number of rows sampled from this many candidates, computed in f32 as on a GPU.
    fn of(self, candidates: usize) -> usize {
        let share = (self.share as f32 * candidates as f32).ceil() as usize;
        share.min(self.most).min(candidates)
    }
}

/// Samples from the rows whose flag in `candidates` `[N]` is above 0.
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

/// The finaliser of MurmurHash3 (Appleby 2011): a bijection after which every bit depends on all bits of the input.
fn scrambled(mut bits: u32) -> u32 {
    bits = (bits ^ (bits >> 16)).wrapping_mul(0x85eb_ca6b);
    bits = (bits ^ (bits >> 13)).wrapping_mul(0xc2b2_ae35);
    bits ^ (bits >> 16)
}
