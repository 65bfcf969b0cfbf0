//! The Adam optimiser (Kingma and Ba 2015) over named parameter groups, with the row operations of density control.
//!
//! Dense: a row whose gradient is zero is updated like any other, its moments decay and may still move it.

mod gpu;
#[cfg(test)]
mod gpu_tests;
mod group;
#[cfg(test)]
mod tests;

pub use group::{Group, GroupState};

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::tape::Tensor;
use crate::tape::chunks::CHUNK;
use crate::tape::simd::multiversion;

/// m ← β1·m + (1 − β1)·g, v ← β2·v + (1 − β2)·g², p ← p − rate·(m / (1 − β1ᵗ)) / (√(v / (1 − β2ᵗ)) + ε).
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Adam {
    pub(crate) beta1: f64,
    pub(crate) beta2: f64,
    /// Gradients of losses that are means over pixels go down to 1e-10: the customary 1e-8 would freeze them.
    pub(crate) epsilon: f64,
}

impl Default for Adam {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-15 }
    }
}

/// One group to update.
pub struct Update<'a> {
    /// The group to update.
    pub group: &'a mut Group,
    /// The gradient, of the group's shape. `None` leaves the group unchanged, moments and step included.
    pub gradient: Option<&'a Tensor<f32>>,
    /// The step size before the bias corrections.
    pub learning_rate: f64,
}

/// The scalars of one update of one group, bias corrections included.
#[derive(Copy, Clone)]
struct Coefficients {
    beta1: f32,
    beta2: f32,
    /// learning rate / (1 − β1ᵗ)
    step_size: f32,
    /// 1 / √(1 − β2ᵗ)
    second_moment_scale: f32,
    epsilon: f32,
}

/// One chunk of one group.
struct Chunk<'a> {
    coefficients: Coefficients,
    gradient: &'a [f32],
    values: &'a mut [f32],
    first_moment: &'a mut [f32],
    second_moment: &'a mut [f32],
}

impl Adam {
    /// Updates all groups: on the GPU where the gradient or the values are, the others in one parallel pass over fixed
    /// chunks.
    pub fn step(&self, updates: &mut [Update]) {
        let (mut chunks, mut of_gpu) = (Vec::new(), Vec::new());
        for (group, gradient, coefficients) in self.counted(updates) {
            match gradient.gpu().or(group.tensor().gpu()) {
                Some(gpu) => of_gpu.push((gpu, (group, gradient, coefficients))),
                None => push_chunks(group, gradient, coefficients, &mut chunks),
            }
        }
        chunks.into_par_iter().for_each(|mut chunk| advance(&mut chunk));
        if let Some(&(gpu, _)) = of_gpu.first() {
            gpu::advance(gpu, &mut of_gpu.into_iter().map(|(_, update)| update).collect::<Vec<_>>());
        }
    }

    /// Updates all groups with a gradient on a GPU, without a readback. Returns the largest magnitudes of each gradient and of
    /// the new values, [groups, 2]; NaN where the tensor contains NaN.
    pub fn step_on(&self, gpu: Gpu, updates: &mut [Update]) -> Tensor<f32> {
        gpu::advance(gpu, &mut self.counted(updates).collect::<Vec<_>>())
    }

    /// Advances the step counter of every group with a gradient, and returns these groups.
    fn counted<'u>(&self, updates: &'u mut [Update]) -> impl Iterator<Item = gpu::Counted<'u>> {
        updates.iter_mut().filter_map(|Update { group, gradient, learning_rate }| {
            let gradient = (*gradient)?;
            assert_eq!(gradient.shape(), group.tensor().shape(), "adam: gradient of group {:?}", group.name());
            let coefficients = self.coefficients(group.count_step(), *learning_rate);
            Some((&mut **group, gradient, coefficients))
        })
    }

    fn coefficients(&self, step: u64, learning_rate: f64) -> Coefficients {
        let correction = |beta: f64| 1.0 - beta.powf(step as f64);
        Coefficients {
            beta1: self.beta1 as f32,
            beta2: self.beta2 as f32,
            step_size: (learning_rate / correction(self.beta1)) as f32,
            second_moment_scale: (1.0 / correction(self.beta2).sqrt()) as f32,
            epsilon: self.epsilon as f32,
        }
    }
}

fn push_chunks<'a>(
    group: &'a mut Group,
    gradient: &'a Tensor<f32>,
    coefficients: Coefficients,
    chunks: &mut Vec<Chunk<'a>>,
) {
    let [values, first_moment, second_moment] = group.slices_mut();
    let moments = first_moment.chunks_mut(CHUNK).zip(second_moment.chunks_mut(CHUNK));
    let parts = gradient.as_slice().chunks(CHUNK).zip(values.chunks_mut(CHUNK)).zip(moments);
    chunks.extend(parts.map(|((gradient, values), (first_moment, second_moment))| Chunk {
        coefficients,
        gradient,
        values,
        first_moment,
        second_moment,
    }));
}

multiversion! {
    fn advance(chunk: &mut Chunk) = advance_body
}

#[inline(always)]
fn advance_body(chunk: &mut Chunk) {
    let Coefficients { beta1, beta2, step_size, second_moment_scale, epsilon } = chunk.coefficients;
    let len = chunk.values.len();
    let (gradient, values) = (&chunk.gradient[..len], &mut chunk.values[..len]);
    let (first, second) = (&mut chunk.first_moment[..len], &mut chunk.second_moment[..len]);
    for i in 0..len {
        first[i] = beta1 * first[i] + (1.0 - beta1) * gradient[i];
        second[i] = beta2 * second[i] + (1.0 - beta2) * (gradient[i] * gradient[i]);
        values[i] -= step_size * first[i] / (second[i].sqrt() * second_moment_scale + epsilon);
    }
}
