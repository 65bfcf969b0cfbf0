//! The kernels of slicing.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::Slicing;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::rasteriser::splats::HIDDEN_LOGIT;
use crate::tape::{Real, Tensor, upstream};

const FORWARD: Kernel = Kernel { name: "slicing4d", text: include_str!("slicing4d.wgsl") };
const BACKWARD: Kernel = Kernel { name: "slicing4d backward", text: include_str!("slicing4d_bwd.wgsl") };

uniforms! {
    struct SlicingBlock as "Slicing" {
        time: f32,
        least_log_share: f32,
        hidden_logit: f32,
        count: u32,
    }
}

impl Slicing {
    fn block(&self, count: usize) -> SlicingBlock {
        let [time, least_log_share, hidden_logit] = [self.time, self.least_log_share, HIDDEN_LOGIT].map(|x| x as f32);
        SlicingBlock { time, least_log_share, hidden_logit, count: count as u32 }
    }

    /// Displacements, velocities, factors, opacities and presence flags.
    pub(super) fn slice_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = inputs[4].len();
        let shapes = [vec![count, 3], vec![count, 3], vec![count, 3, 3], vec![count, 1], vec![count, 1]];
        let outputs = shapes.each_ref().map(|shape| GpuArray::new(gpu, shape.iter().product()));
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain(outputs.iter().map(Binding::Write)).collect();
        FORWARD.launch(gpu, &[], &self.block(count), &arrays, Groups::Over(count));
        shapes.into_iter().zip(outputs).map(|(shape, array)| Tensor::from_gpu(shape, array)).collect()
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
    ) -> Vec<Option<Tensor<T>>> {
        let count = inputs[4].len();
        let (mask, of_outputs) = upstream(gpu, &output_grads[..4], inputs[4].on_gpu(gpu));
        let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu))).chain(of_outputs);
        let arrays: Vec<Binding> = read.chain(gradients.iter().map(Binding::Write)).collect();
        BACKWARD.launch(gpu, &[("ARRIVING", mask)], &self.block(count), &arrays, Groups::Over(count));
        let tensor = |(array, input): (GpuArray, &&Tensor<T>)| Some(Tensor::from_gpu(input.shape(), array));
        gradients.into_iter().zip(inputs).map(tensor).collect()
    }
}
