//! The kernels of group normalisation.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::GroupNorm;
use crate::gpu::column_sums::Terms;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::{Real, Tensor};

const TERMS: Kernel = Kernel { name: "group norm, terms", text: include_str!("group_norm_terms.wgsl") };
const STATISTICS: Kernel = Kernel { name: "group norm, statistics", text: include_str!("group_norm_statistics.wgsl") };
const FORWARD: Kernel = Kernel { name: "group norm", text: include_str!("group_norm.wgsl") };
const BACKWARD_TERMS: Kernel =
    Kernel { name: "group norm backward, terms", text: include_str!("group_norm_bwd_terms.wgsl") };
const BACKWARD: Kernel = Kernel { name: "group norm backward", text: include_str!("group_norm_bwd.wgsl") };

uniforms! {
    struct StatisticsBlock as "Statistics" {
        pixels: u32,
        blocks: u32,
        groups: u32,
    }
}

uniforms! {
    struct NormBlock as "GroupNorm" {
        len: u32,
        channels: u32,
    }
}

/// [groups] each.
pub(super) struct GpuStatistics {
    means: GpuArray,
    /// 1/√(σ² + ε).
    inverses: GpuArray,
}

impl GroupNorm {
    fn per_group(&self) -> (&'static str, u32) {
        ("PER_GROUP", (self.channels / self.groups) as u32)
    }

    fn block<T: Real>(&self, x: &Tensor<T>) -> NormBlock {
        NormBlock { len: x.len() as u32, channels: self.channels as u32 }
    }

    /// The mean of every group's values or, given the means, 1/√(mean of squared differences + ε).
    fn statistic_on_gpu<T: Real>(&self, gpu: Gpu, x: &Tensor<T>, means: Option<&GpuArray>) -> GpuArray {
        let x_on_gpu = x.on_gpu(gpu);
        // x is the placeholder of missing means.
        let arrays = [x_on_gpu, means.unwrap_or(x_on_gpu)].map(Binding::Read);
        let specialisation = [self.per_group(), ("SQUARES", u32::from(means.is_some()))];
        let (rows, columns) = (x.len() / self.channels, self.channels);
        let terms = Terms { kernel: &TERMS, specialisation: &specialisation, arrays: &arrays, rows, columns };
        let (block_sums, blocks) = terms.block_sums(gpu);
        let statistic = GpuArray::new(gpu, self.groups);
        let [pixels, blocks, groups] = [rows, blocks, self.groups].map(|size| size as u32);
        let arrays = [Binding::Read(&block_sums), Binding::Write(&statistic)];
        let specialisation = [&specialisation[..], &[("LANES", WORKGROUP_SIZE as u32)]].concat();
        let block = StatisticsBlock { pixels, blocks, groups };
        STATISTICS.launch(gpu, &specialisation, &block, &arrays, self.groups);
        statistic
    }

    pub(super) fn forward_on_gpu<T: Real>(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let x = inputs[0];
        let means = self.statistic_on_gpu(gpu, x, None);
        let inverses = self.statistic_on_gpu(gpu, x, Some(&means));
        let y = GpuArray::new(gpu, x.len());
        let read = inputs.iter().map(|input| input.on_gpu(gpu)).chain([&means, &inverses]).map(Binding::Read);
        let arrays: Vec<Binding> = read.chain([Binding::Write(&y)]).collect();
        FORWARD.launch(gpu, &[self.per_group()], &self.block(x), &arrays, Groups::Over(y.len()));
        self.on_gpu = Some(GpuStatistics { means, inverses });
        Tensor::from_gpu(x.shape(), y)
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        dy: &Tensor<T>,
    ) -> Vec<Option<Tensor<T>>> {
        let GpuStatistics { means, inverses } = self.on_gpu.as_ref().expect("the forward pass kept them");
        let (x, statistics) = (inputs[0], [means, inverses].map(Binding::Read));
        let [x_read, scale, dy] = [x, inputs[1], dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&[x_read, dy][..], &statistics].concat();
        let specialisation = [self.per_group()];
        let (rows, columns) = (x.len() / self.channels, self.channels);
        let terms = Terms { kernel: &BACKWARD_TERMS, specialisation: &specialisation, arrays: &arrays, rows, columns };
        let [to_shift, to_scale] = terms.sums(gpu);

        let dx = GpuArray::new(gpu, x.len());
        let sums = [&to_shift, &to_scale].map(Binding::Read);
        let arrays = [&[x_read, scale, dy][..], &statistics, &sums, &[Binding::Write(&dx)]].concat();
        BACKWARD.launch(gpu, &specialisation, &self.block(x), &arrays, Groups::Over(dx.len()));
        let gradients = [dx, to_scale, to_shift].into_iter().zip(inputs);
        gradients.map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}
