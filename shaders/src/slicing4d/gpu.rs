//! The kernels of slicing.

#[cfg(test)]
mod tests;

use super::Slicing;
use crate::algebra;
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, arriving, uniforms};
use crate::tape::{Real, Tensor};

const CUT: &str = include_str!("cut.wgsl");
const GAUSSIAN: &str = include_str!("gaussian.wgsl");
const FORWARD: Kernel =
    Kernel { name: "slicing4d", text: &[algebra::WGSL, CUT, GAUSSIAN, include_str!("slicing4d.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "slicing4d backward", text: &[algebra::WGSL, CUT, include_str!("slicing4d_bwd.wgsl")] };
const ROWS: Kernel =
    Kernel { name: "slicing4d, rows", text: &[algebra::WGSL, CUT, GAUSSIAN, include_str!("slicing4d_rows.wgsl")] };

/// Gaussians per workgroup: few, because each invocation holds many numbers.
const GROUP: usize = 64;
/// Gaussians per workgroup of the choice.
const ROWS_GROUP: usize = 256;
/// Elements of a Gaussian that is kept, with two that align it.
const KEPT: usize = 16;

uniforms! {
    struct SlicingBlock as "Slicing" {
        time: f32,
        least_log_share: f32,
        count: u32,
    }
}

/// As [`super::rows_at`]: reads back one bit per Gaussian.
pub(super) fn rows_at<T: Real>(gpu: Gpu, inputs: &[&Tensor<T>; 6], time: f64, least_log_share: f64) -> Vec<u32> {
    let count = inputs[4].len();
    let words = GpuArray::new(gpu, count.div_ceil(32));
    let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
    let arrays: Vec<Binding> = read.chain([Binding::Write(&words)]).collect();
    let constants = SlicingBlock { time: time as f32, least_log_share: least_log_share as f32, count: count as u32 };
    ROWS.launch(gpu, &[], &constants, &arrays, count.div_ceil(ROWS_GROUP));
    let mut bits = vec![0_u32; words.len()];
    words.read_into(&mut bits);
    (0..count as u32).filter(|&row| bits[row as usize / 32] >> (row % 32) & 1 == 1).collect()
}

impl<T: Real> Slicing<T> {
    fn block(&self, count: usize) -> SlicingBlock {
        SlicingBlock { time: self.time.to_f64() as f32, least_log_share: 0.0, count: count as u32 }
    }

    /// Displacements, velocities, factors and opacities.
    pub(super) fn slice_on_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = self.rows.len();
        let shapes = [vec![count, 3], vec![count, 3], vec![count, 3, 3], vec![count, 1]];
        let outputs = shapes.each_ref().map(|shape| GpuArray::new(gpu, shape.iter().product()));
        // One at least: the backward pass sees them even where nothing was chosen.
        let kept = GpuArray::new(gpu, KEPT * count.max(1));
        let read = inputs.iter().map(|input| input.on_gpu(gpu)).chain([&self.rows.on_gpu(gpu).row_of_item]);
        let written = outputs.iter().chain([&kept]).map(Binding::Write);
        let arrays: Vec<Binding> = read.map(Binding::Read).chain(written).collect();
        FORWARD.launch(gpu, &[], &self.block(count), &arrays, count.div_ceil(GROUP));
        self.kept = Some(kept);
        shapes.into_iter().zip(outputs).map(|(shape, array)| Tensor::from_gpu(shape, array)).collect()
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
    ) -> Option<Vec<Option<Tensor<T>>>> {
        let kept = self.kept.as_ref()?;
        let (index, count) = (self.rows.on_gpu(gpu), self.rows.rows());
        let (mask, arriving) = arriving(gpu, output_grads, kept);
        let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
        let read = [kept, &index.items, &index.starts].map(Binding::Read).into_iter().chain(arriving);
        let arrays: Vec<Binding> = read.chain(gradients.iter().map(Binding::Write)).collect();
        BACKWARD.launch(gpu, &[("ARRIVING", mask)], &self.block(count), &arrays, count.div_ceil(GROUP));
        let tensor = |(array, input): (GpuArray, &&Tensor<T>)| Some(Tensor::from_gpu(input.shape(), array));
        Some(gradients.into_iter().zip(inputs).map(tensor).collect())
    }
}
