//! 4D Gaussians cut at one instant: 3D Gaussians that move, turn and fade (Yang et al. 2024, "Real-time photorealistic
//! dynamic scene representation and rendering with 4D Gaussian splatting", equations 5 to 8).
//!
//! With the covariance Σ = R·diag(e²ˢ)·Rᵀ in (x, y, z, t), R of two quaternions, and Δt = t − μₜ:
//! the mean moves by Δt·Σ₁₄/Σ₄₄, the covariance is the Schur complement Σ₁₁ − Σ₁₄Σ₁₄ᵀ/Σ₄₄, and the opacity is multiplied
//! by e^(−½Δt²/Σ₄₄).
//!
//! Nothing is subtracted: a reflection H that takes the time row of L = R·diag(eˢ) to the last axis leaves L·H with zeros
//! in front of its corner, so that the first three columns of its first three rows are a factor of the Schur complement,
//! which is therefore positive semi-definite, also where a flat Gaussian is ten thousand times as long in time.

mod algebra;
mod gpu;
mod reference;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::rasteriser::splats::HIDDEN_LOGIT;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};
use reference::{Gaussian, Sliced};

/// Gaussians per parallel chunk: tens of microseconds.
const ROWS_PER_CHUNK: usize = 128;

/// The parameters of N 4D Gaussians that determine their slices.
#[derive(Clone, Copy, Debug)]
pub struct Gaussians4dVars {
    /// [N, 3] natural logarithm of the spatial standard deviations before rotation, scene units.
    pub log_scales: Var,
    /// [N, 1] logarithm of the temporal standard deviation, in units of time.
    pub log_scales_time: Var,
    /// [N, 4] quaternions (w, x, y, z) of any length: R·p = q_l ⊗ p ⊗ q̄_r with t as the real part of p. Equal
    /// quaternions rotate space alone, like the quaternion of a 3D Gaussian.
    pub rotations_left: Var,
    /// [N, 4] q_r: quaternions (w, x, y, z) of any length; see `rotations_left`.
    pub rotations_right: Var,
    /// [N, 1] μₜ.
    pub times: Var,
    /// [N, 1] before the logistic function.
    pub opacity_logits: Var,
}

impl Gaussians4dVars {
    fn inputs(&self) -> [Var; 6] {
        let Self { log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits } = *self;
        [log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits]
    }
}

/// The Gaussians at one instant; absent ones are zeros with the opacity [`HIDDEN_LOGIT`].
#[derive(Clone, Copy, Debug)]
pub struct SlicedVars {
    /// [N, 3] from the mean in space and time to the mean at the instant, scene units.
    pub displacements: Var,
    /// [N, 3] Σ₁₄/Σ₄₄, scene units per unit of time.
    pub velocities: Var,
    /// [N, 3, 3] F with FFᵀ = the covariance at the instant, scene units.
    pub factors: Var,
    /// [N, 1] the logits of the opacities times their share at the instant.
    pub opacity_logits: Var,
    /// [N, 1] 1 for present Gaussians, otherwise 0; without gradient.
    pub present: Var,
}

/// Slices the Gaussians at an instant. A Gaussian is present if more than `least_share` of its opacity remains. Panics if
/// shapes disagree.
pub fn slice<T: Real>(tape: &mut Tape<T>, vars: &Gaussians4dVars, time: f64, least_share: f64) -> SlicedVars {
    let count = tape.value(vars.times).len();
    for (var, row_len) in vars.inputs().into_iter().zip([3, 1, 4, 4, 1, 1]) {
        assert_eq!(tape.value(var).len(), count * row_len, "slicing: a parameter has the wrong shape");
    }
    let slicing = Slicing { time, least_log_share: least_share.ln() };
    let outputs = tape.apply(slicing, &vars.inputs());
    let [displacements, velocities, factors, opacity_logits, present] = outputs[..] else {
        unreachable!("five outputs")
    };
    SlicedVars { displacements, velocities, factors, opacity_logits, present }
}

struct Slicing {
    time: f64,
    least_log_share: f64,
}

impl Slicing {
    /// One Gaussian, if it is present.
    fn present<T: Real>(&self, inputs: &[&Tensor<T>], row: usize) -> Option<Gaussian<T>> {
        let gaussian = gaussian(inputs, row, T::from_f64(self.time));
        // Negated, so that NaN counts as present and is detected.
        (!(gaussian.log_share() <= T::from_f64(self.least_log_share))).then_some(gaussian)
    }
}

impl<T: Real> Op<T> for Slicing {
    fn name(&self) -> &'static str {
        "slicing4d"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = inputs[4].len();
        let hidden = Sliced { opacity_logit: T::from_f64(HIDDEN_LOGIT), ..Sliced::default() };
        let slice = |row| self.present(inputs, row).map(|gaussian| reference::slice(&gaussian));
        let sliced: Vec<Option<Sliced<T>>> =
            (0..count).into_par_iter().with_min_len(ROWS_PER_CHUNK).map(slice).collect();
        let all = || sliced.iter().map(|row| row.as_ref().unwrap_or(&hidden));
        let present = sliced.iter().map(|row| T::from_f64(f64::from(u8::from(row.is_some()))));
        vec![
            Tensor::from_vec([count, 3], all().flat_map(|row| row.displacement).collect()),
            Tensor::from_vec([count, 3], all().flat_map(|row| row.velocity).collect()),
            Tensor::from_vec([count, 3, 3], all().flat_map(|row| row.factor).flatten().collect()),
            Tensor::from_vec([count, 1], all().map(|row| row.opacity_logit).collect()),
            Tensor::from_vec([count, 1], present.collect()),
        ]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        let backward = |row| {
            let gaussian = self.present(inputs, row)?;
            Some(reference::backward(&gaussian, &upstream_of(output_grads, row)))
        };
        let of_rows: Vec<Option<Gaussian<T>>> =
            (0..inputs[4].len()).into_par_iter().with_min_len(ROWS_PER_CHUNK).map(backward).collect();
        let mut gradients: Vec<Vec<T>> = inputs.iter().map(|input| vec![T::ZERO; input.len()]).collect();
        for (row, gradient) in of_rows.iter().enumerate() {
            let Some(gradient) = gradient else { continue };
            let Gaussian { log_scales: [x, y, z, t], rotation_left, rotation_right, .. } = *gradient;
            let late = -gradient.offset_time;
            let parts: [&[T]; 6] =
                [&[x, y, z], &[t], &rotation_left, &rotation_right, &[late], &[gradient.opacity_logit]];
            for (total, part) in gradients.iter_mut().zip(parts) {
                total[row * part.len()..][..part.len()].copy_from_slice(part);
            }
        }
        gradients.into_iter().zip(inputs).map(|(data, input)| Some(Tensor::from_vec(input.shape(), data))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Slicing {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(self.slice_on_gpu(gpu, inputs))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        self.backward_on_gpu(gpu, inputs, output_grads)
    }
}

fn gaussian<T: Real>(inputs: &[&Tensor<T>], row: usize, time: T) -> Gaussian<T> {
    let [x, y, z]: [T; 3] = row_of(inputs[0], row);
    Gaussian {
        log_scales: [x, y, z, inputs[1].as_slice()[row]],
        rotation_left: row_of(inputs[2], row),
        rotation_right: row_of(inputs[3], row),
        offset_time: time - inputs[4].as_slice()[row],
        opacity_logit: inputs[5].as_slice()[row],
    }
}

/// The upstream gradient of one slice; zero if there is none.
fn upstream_of<T: Real>(output_grads: &[Option<&Tensor<T>>], at: usize) -> Sliced<T> {
    Sliced {
        displacement: output_grads[0].map_or_else(Default::default, |gradient| row_of(gradient, at)),
        velocity: output_grads[1].map_or_else(Default::default, |gradient| row_of(gradient, at)),
        factor: output_grads[2].map_or_else(Default::default, |gradient| {
            [0, 1, 2].map(|axis| row_of(gradient, 3 * at + axis)) //
        }),
        opacity_logit: output_grads[3].map_or(T::ZERO, |gradient| gradient.as_slice()[at]),
    }
}

fn row_of<T: Real, const LEN: usize>(tensor: &Tensor<T>, index: usize) -> [T; LEN] {
    tensor.as_slice().as_chunks::<LEN>().0[index]
}
