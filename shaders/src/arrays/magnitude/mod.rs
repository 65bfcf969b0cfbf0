//! The largest magnitude of each of many tensors: the trainer's check for non-finite values.

mod gpu;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use crate::tape::Tensor;

/// Values per parallel chunk of a search for the largest: tens of microseconds.
const VALUES_PER_CHUNK: usize = 1 << 16;

/// The largest magnitude in each tensor, NaN if it contains NaN, 0 if it is empty. Tensors on a GPU are reduced
/// there; one readback returns one number per tensor.
pub fn largest_magnitudes(tensors: &[&Tensor<f32>]) -> Vec<f32> {
    let mut largest = vec![0.0; tensors.len()];
    let (on_gpu, on_host): (Vec<usize>, Vec<usize>) =
        (0..tensors.len()).partition(|&index| !tensors[index].is_on_host());
    for index in on_host {
        largest[index] = largest_magnitude(tensors[index].as_slice());
    }
    let of_gpu: Vec<&Tensor<f32>> = on_gpu.iter().map(|&index| tensors[index]).collect();
    for (index, magnitude) in on_gpu.into_iter().zip(gpu::largest_magnitudes(&of_gpu)) {
        largest[index] = magnitude;
    }
    largest
}

/// Without their sign, floats order as their bits do, NaN last.
fn largest_magnitude(values: &[f32]) -> f32 {
    let of_part = |part: &[f32]| part.iter().fold(0, |largest: u32, value| largest.max(value.to_bits() & !(1 << 31)));
    f32::from_bits(values.par_chunks(VALUES_PER_CHUNK).map(of_part).max().unwrap_or(0))
}
