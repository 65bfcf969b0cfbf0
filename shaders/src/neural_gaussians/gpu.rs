//! The kernels of the Gaussians that anchors spawn.

#[cfg(test)]
mod tests;

use super::{Chosen, Spawn};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, arriving, uniforms};
use crate::tape::{Real, Tensor};

const SPAWN: &str = include_str!("spawn.wgsl");
const FORWARD: Kernel = Kernel { name: "neural gaussians", text: &[SPAWN, include_str!("neural_gaussians.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "neural gaussians backward", text: &[SPAWN, include_str!("neural_gaussians_bwd.wgsl")] };
const ANCHORS_BACKWARD: Kernel = Kernel {
    name: "neural gaussians backward, anchors",
    text: &[SPAWN, include_str!("neural_gaussians_anchors_bwd.wgsl")],
};

/// Invocations per workgroup.
const GROUP: usize = 256;

uniforms! {
    struct SpawnBlock as "Spawn" {
        anchors: u32,
        per_anchor: u32,
        gaussians: u32,
    }
}

/// The lists of [`Chosen`] in the GPU's memory.
pub(super) struct GpuChosen {
    /// [M].
    slots: GpuArray,
    /// [N + 1].
    first: GpuArray,
}

impl Chosen {
    fn anchors(&self) -> usize {
        self.first.len() - 1
    }

    fn block(&self) -> SpawnBlock {
        let sizes = [self.anchors(), self.per_anchor, self.slots.len()].map(|size| size as u32);
        let [anchors, per_anchor, gaussians] = sizes;
        SpawnBlock { anchors, per_anchor, gaussians }
    }

    /// The lists in the GPU's memory, uploaded once.
    fn on_gpu(&self, gpu: Gpu) -> &GpuChosen {
        self.on_gpu.get_or_init(|| GpuChosen {
            slots: GpuArray::upload(gpu, &self.slots),
            first: GpuArray::upload(gpu, &self.first),
        })
    }
}

impl Spawn {
    /// Positions, scales, rotations, opacities and harmonics.
    pub(super) fn spawn_on_gpu<T: Real>(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = self.chosen.slots.len();
        let shapes = [vec![count, 3], vec![count, 3], vec![count, 4], vec![count, 1], vec![count, 1, 3]];
        let outputs = shapes.each_ref().map(|shape| GpuArray::new(gpu, shape.iter().product()));
        let read = inputs.iter().map(|input| input.on_gpu(gpu)).chain([&self.chosen.on_gpu(gpu).slots]);
        let arrays: Vec<Binding> = read.map(Binding::Read).chain(outputs.iter().map(Binding::Write)).collect();
        FORWARD.launch(gpu, &[], &self.chosen.block(), &arrays, count.div_ceil(GROUP));
        shapes.into_iter().zip(outputs).map(|(shape, array)| Tensor::from_gpu(shape, array)).collect()
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
    ) -> Vec<Option<Tensor<T>>> {
        let (chosen, block) = (self.chosen.on_gpu(gpu), self.chosen.block());
        let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
        let [_, log_scales, offsets, opacities, shapes, _] = inputs[..] else { unreachable!("six inputs") };
        let [log_scales, offsets, opacities, shapes] =
            [log_scales, offsets, opacities, shapes].map(|input| Binding::Read(input.on_gpu(gpu)));
        let lists = [&chosen.slots, &chosen.first].map(Binding::Read);
        let written: Vec<Binding> = gradients.iter().map(Binding::Write).collect();

        let (mask, by_output) = arriving(gpu, output_grads, &chosen.first);
        let of_slots = [&[log_scales, opacities, shapes][..], &lists, &by_output, &written[2..]].concat();
        let slots = self.chosen.anchors() * self.chosen.per_anchor;
        BACKWARD.launch(gpu, &[("ARRIVING", mask)], &block, &of_slots, slots.div_ceil(GROUP));

        let (mask, by_output) = arriving(gpu, &output_grads[..2], &chosen.first);
        let of_anchors = [&[log_scales, offsets][..], &lists, &by_output, &written[..2]].concat();
        let groups = self.chosen.anchors().div_ceil(GROUP);
        ANCHORS_BACKWARD.launch(gpu, &[("ARRIVING", mask)], &block, &of_anchors, groups);
        gradients.into_iter().zip(inputs).map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}
