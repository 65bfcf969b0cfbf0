//! The Gaussians that anchors spawn (Lu et al. 2024, Scaffold-GS, section 3.2).
//!
//! An anchor at a with logarithmic scales s (three of its offsets, three of its Gaussians) has K Gaussians. The network
//! outputs for Gaussian k (opacity α, shape c₁…₇ and colour) become
//!
//! * position μ = a + oₖ ∘ exp(s₁₋₃),
//! * logarithmic scales s₄₋₆ + ln sigmoid(c₁₋₃),
//! * quaternion c₄₋₇ (normalised by the rasteriser),
//! * opacity logit ln(α / (1 − α)), and the colour as the constant spherical harmonic.
//!
//! Gaussians with α ≤ 0 are absent: the CPU omits them; a GPU keeps them with [`HIDDEN_LOGIT`], because compaction would need
//! a readback. The transition is invisible in renders: opacities rise from 0.

mod backward;
mod gpu;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;
use scene::gaussians::SH_C0;

use crate::gpu::Gpu;
use crate::rasteriser::splats::HIDDEN_LOGIT;
use crate::tape::{Backward, Device, GpuOp, Op, Real, Tape, Tensor, Var, exactly};
use backward::Gradients;

/// Opacities are kept this far from 0 and 1, where their logit is infinite; the difference is invisible in an image.
const OPACITY_MARGIN: f64 = 1e-6;
/// Output rows, or anchors, per parallel chunk: tens of microseconds of work.
const ROWS_PER_CHUNK: usize = 1024;
/// Columns of a shape: three scales and a quaternion.
const SHAPE: usize = 7;

/// N anchors and the network outputs for K Gaussians each.
#[derive(Clone, Copy, Debug)]
pub struct AnchorVars {
    /// [N, 3] world, scene units.
    pub positions: Var,
    /// [N, 6] natural logarithms: three scales of the offsets, three of the Gaussians, scene units.
    pub log_scales: Var,
    /// [N, 3K] in units of the anchor's first three scales.
    pub offsets: Var,
    /// [N, K] in (−1, 1).
    pub opacities: Var,
    /// [N, 7K]: three scales before the logistic function and a quaternion (w, x, y, z).
    pub shapes: Var,
    /// [N, 3K] in [0, 1].
    pub colors: Var,
}

/// M Gaussians in the order of the anchors: those with positive opacity, or all on a GPU.
#[derive(Clone, Debug)]
pub struct NeuralGaussians {
    /// [M, 3] world, scene units.
    pub positions: Var,
    /// [M, 3] natural logarithm of the standard deviations, scene units.
    pub log_scales: Var,
    /// [M, 4] quaternions (w, x, y, z), not normalised.
    pub rotations: Var,
    /// [M, 1] before the logistic function; [`HIDDEN_LOGIT`] where the opacity is not positive.
    pub opacity_logits: Var,
    /// [M, 1, 3] the constant spherical harmonic.
    pub sh: Var,
    /// `[M]` the slot anchor·K + k of each Gaussian; `None`: all N·K in order.
    pub slots: Option<Arc<Vec<u32>>>,
}

/// The Gaussians that anchors spawn; differentiable in everything but whether an opacity is positive.
pub fn neural_gaussians<T: Real>(tape: &mut Tape<T>, anchors: &AnchorVars) -> NeuralGaussians {
    let opacities = tape.value(anchors.opacities);
    let chosen = match tape.device() {
        Device::Cpu => Chosen::with_positive(opacities),
        Device::Gpu(_) => Chosen::all(opacities),
    };
    spawn(tape, anchors, chosen)
}

fn spawn<T: Real>(tape: &mut Tape<T>, anchors: &AnchorVars, chosen: Chosen) -> NeuralGaussians {
    let (count, per_anchor) = (chosen.anchors, chosen.per_anchor);
    let AnchorVars { positions, log_scales, offsets, opacities, shapes, colors } = *anchors;
    let inputs = [positions, log_scales, offsets, opacities, shapes, colors];
    for (var, row_len) in inputs.into_iter().zip([3, 6, 3 * per_anchor, per_anchor, SHAPE * per_anchor, 3 * per_anchor])
    {
        let shape = tape.value(var).shape();
        assert!(shape[0] == count && tape.value(var).row_len() == row_len, "neural_gaussians: a shape {shape:?}");
    }
    let slots = chosen.list.as_ref().map(|list| list.slots.clone());
    let outputs = tape.apply(Spawn { chosen }, &inputs);
    let [positions, log_scales, rotations, opacity_logits, sh] = outputs[..] else { unreachable!("five outputs") };
    NeuralGaussians { positions, log_scales, rotations, opacity_logits, sh, slots }
}

/// Which of the N·K Gaussians are spawned.
struct Chosen {
    anchors: usize,
    per_anchor: usize,
    /// The listed Gaussians; `None`: all.
    list: Option<List>,
}

/// Some of the N·K Gaussians.
struct List {
    /// [M].
    slots: Arc<Vec<u32>>,
    /// [N + 1]: the Gaussians of anchor n are those from `first[n]` to `first[n + 1]`.
    first: Vec<u32>,
}

impl Chosen {
    /// All Gaussians of anchors with these opacities [N, K].
    fn all<T: Real>(opacities: &Tensor<T>) -> Self {
        Self { anchors: opacities.rows(), per_anchor: opacities.row_len(), list: None }
    }

    /// The Gaussians with positive opacity.
    fn with_positive<T: Real>(opacities: &Tensor<T>) -> Self {
        let all = Self::all(opacities);
        let (mut slots, mut first) = (Vec::new(), vec![0]);
        for anchor in 0..all.anchors {
            let chosen = opacities.row(anchor).iter().enumerate().filter(|(_, opacity)| !is_hidden(**opacity));
            slots.extend(chosen.map(|(k, _)| (anchor * all.per_anchor + k) as u32));
            first.push(slots.len() as u32);
        }
        Self { list: Some(List { slots: Arc::new(slots), first }), ..all }
    }

    /// The number of Gaussians.
    fn count(&self) -> usize {
        self.list.as_ref().map_or(self.anchors * self.per_anchor, |list| list.slots.len())
    }

    /// Anchor·K + k of a Gaussian.
    fn slot(&self, gaussian: usize) -> usize {
        self.list.as_ref().map_or(gaussian, |list| list.slots[gaussian] as usize)
    }

    /// The index of a Gaussian among those of its anchor.
    fn k(&self, gaussian: usize) -> usize {
        self.slot(gaussian) % self.per_anchor
    }

    /// The Gaussians of an anchor.
    fn gaussians(&self, anchor: usize) -> Range<usize> {
        let first =
            |anchor: usize| self.list.as_ref().map_or(anchor * self.per_anchor, |list| list.first[anchor] as usize);
        first(anchor)..first(anchor + 1)
    }

    /// [M, width]: `body(anchor, k, row)` for every Gaussian.
    fn rows<T: Real>(&self, width: usize, body: impl Fn(usize, usize, &mut [T]) + Sync) -> Vec<T> {
        let mut rows = vec![T::ZERO; self.count() * width];
        rows.par_chunks_mut(width * ROWS_PER_CHUNK).enumerate().for_each(|(chunk, rows)| {
            for (index, row) in rows.chunks_exact_mut(width).enumerate() {
                let slot = self.slot(chunk * ROWS_PER_CHUNK + index);
                body(slot / self.per_anchor, slot % self.per_anchor, row);
            }
        });
        rows
    }

    /// The gradient of an input [N, …]: `body(anchor, Gaussians of that anchor, row)` for every anchor.
    fn per_anchor<T: Real>(
        &self,
        input: &Tensor<T>,
        body: impl Fn(usize, Range<usize>, &mut [T]) + Sync,
    ) -> Option<Tensor<T>> {
        let width = input.row_len();
        let mut rows = vec![T::ZERO; input.len()];
        rows.par_chunks_mut(width * ROWS_PER_CHUNK).enumerate().for_each(|(chunk, rows)| {
            for (index, row) in rows.chunks_exact_mut(width).enumerate() {
                let anchor = chunk * ROWS_PER_CHUNK + index;
                body(anchor, self.gaussians(anchor), row);
            }
        });
        Some(Tensor::from_vec(input.shape(), rows))
    }
}

struct Spawn {
    chosen: Chosen,
}

impl<T: Real> Op<T> for Spawn {
    fn name(&self) -> &'static str {
        "neural_gaussians"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [positions, log_scales, offsets, opacities, shapes, colors] = exactly(inputs);
        let (chosen, count) = (&self.chosen, self.chosen.count());
        let to_position = chosen.rows(3, |anchor, k, row: &mut [T]| {
            let (center, offset, scale) =
                (positions.row(anchor), &offsets.row(anchor)[3 * k..], log_scales.row(anchor));
            (0..3).for_each(|axis| row[axis] = center[axis] + offset[axis] * scale[axis].exp());
        });
        let to_log_scale = chosen.rows(3, |anchor, k, row: &mut [T]| {
            let (scale, shape) = (&log_scales.row(anchor)[3..], &shapes.row(anchor)[SHAPE * k..]);
            (0..3).for_each(|axis| row[axis] = scale[axis] + log_sigmoid(shape[axis]));
        });
        let to_rotation = chosen.rows(4, |anchor, k, row: &mut [T]| {
            row.copy_from_slice(&shapes.row(anchor)[SHAPE * k + 3..SHAPE * (k + 1)]);
        });
        let to_logit = chosen.rows(1, |anchor, k, row: &mut [T]| {
            row[0] = logit(opacities.row(anchor)[k]);
        });
        let to_harmonic = chosen.rows(3, |anchor, k, row: &mut [T]| {
            let color = &colors.row(anchor)[3 * k..];
            let c0 = T::from_f64(f64::from(SH_C0));
            (0..3).for_each(|channel| row[channel] = (color[channel] - T::from_f64(0.5)) / c0);
        });
        vec![
            Tensor::from_vec([count, 3], to_position),
            Tensor::from_vec([count, 3], to_log_scale),
            Tensor::from_vec([count, 4], to_rotation),
            Tensor::from_vec([count, 1], to_logit),
            Tensor::from_vec([count, 1, 3], to_harmonic),
        ]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, needs, .. } = pass;
        let of = Gradients { chosen: &self.chosen, inputs, output_grads };
        vec![
            needs[0].then(|| of.positions()).flatten(),
            needs[1].then(|| of.log_scales()).flatten(),
            needs[2].then(|| of.offsets()).flatten(),
            needs[3].then(|| of.opacities()).flatten(),
            needs[4].then(|| of.shapes()).flatten(),
            needs[5].then(|| of.colors()).flatten(),
        ]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Spawn {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(self.spawn_on_gpu(gpu, inputs))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        self.backward_on_gpu(gpu, inputs, output_grads)
    }
}

/// Whether a Gaussian with this opacity is hidden; NaN is not hidden, so that it is detected.
fn is_hidden<T: Real>(opacity: T) -> bool {
    opacity <= T::ZERO
}

/// The logit of an opacity; constant for hidden Gaussians.
fn logit<T: Real>(opacity: T) -> T {
    if is_hidden(opacity) {
        return T::from_f64(HIDDEN_LOGIT);
    }
    let (opacity, _) = inside(opacity);
    (opacity / (T::ONE - opacity)).ln()
}

/// ln(1 / (1 + e^−x)), from the exponential that cannot overflow.
fn log_sigmoid<T: Real>(x: T) -> T {
    let low = if x < T::ZERO { x } else { T::ZERO };
    low - (T::ONE + (-x.abs()).exp()).ln()
}

/// An opacity clamped away from 0 and 1, and whether it was in that range; a NaN stays a NaN.
fn inside<T: Real>(opacity: T) -> (T, bool) {
    let (low, high) = (T::from_f64(OPACITY_MARGIN), T::from_f64(1.0 - OPACITY_MARGIN));
    if opacity < low {
        (low, false)
    } else if opacity > high {
        (high, false)
    } else {
        (opacity, true)
    }
}
