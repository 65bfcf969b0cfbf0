//! The kernels of the Gaussians that anchors spawn.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::{Chosen, Spawn};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor, upstream};

const FORWARD: Kernel = Kernel { name: "neural gaussians", text: include_str!("neural_gaussians.wgsl") };
const BACKWARD: Kernel = Kernel { name: "neural gaussians backward", text: include_str!("neural_gaussians_bwd.wgsl") };
const ANCHORS_BACKWARD: Kernel =
    Kernel { name: "neural gaussians backward, anchors", text: include_str!("neural_gaussians_anchors_bwd.wgsl") };

uniforms! {
    struct SpawnBlock as "Spawn" {
        anchors: u32,
        per_anchor: u32,
    }
}

impl Chosen {
    fn block(&self) -> SpawnBlock {
        assert!(self.list.is_none(), "on a GPU every Gaussian has a row");
        SpawnBlock { anchors: self.anchors as u32, per_anchor: self.per_anchor as u32 }
    }
}

impl Spawn {
    /// Positions, scales, rotations, opacities and harmonics.
    pub(super) fn spawn_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = self.chosen.count();
        let shapes = [vec![count, 3], vec![count, 3], vec![count, 4], vec![count, 1], vec![count, 1, 3]];
        let outputs = shapes.each_ref().map(|shape| GpuArray::new(gpu, shape.iter().product()));
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain(outputs.iter().map(Binding::Write)).collect();
        FORWARD.launch(gpu, &[], &self.chosen.block(), &arrays, Groups::Over(count));
        shapes.into_iter().zip(outputs).map(|(shape, array)| Tensor::from_gpu(shape, array)).collect()
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
    ) -> Vec<Option<Tensor<T>>> {
        let (block, otherwise) = (self.chosen.block(), inputs[0].on_gpu(gpu));
        let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
        let [_, log_scales, offsets, opacities, shapes, _] = inputs[..] else { unreachable!("six inputs") };
        let [log_scales, offsets, opacities, shapes] =
            [log_scales, offsets, opacities, shapes].map(|input| Binding::Read(input.on_gpu(gpu)));
        let written: Vec<Binding> = gradients.iter().map(Binding::Write).collect();

        let (mask, by_output) = upstream(gpu, output_grads, otherwise);
        let of_gaussians = [&[log_scales, opacities, shapes][..], &by_output, &written[2..]].concat();
        BACKWARD.launch(gpu, &[("ARRIVING", mask)], &block, &of_gaussians, Groups::Over(self.chosen.count()));

        let (mask, by_output) = upstream(gpu, &output_grads[..2], otherwise);
        let of_anchors = [&[log_scales, offsets][..], &by_output, &written[..2]].concat();
        let groups = Groups::Over(self.chosen.anchors);
        ANCHORS_BACKWARD.launch(gpu, &[("ARRIVING", mask)], &block, &of_anchors, groups);
        gradients.into_iter().zip(inputs).map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}
