//! The kernels of histograms.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::SoftHistogram;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::{Real, Tensor};

const BLOCKS: Kernel = Kernel { name: "soft histogram", text: include_str!("histogram.wgsl") };
const TOTAL: Kernel = Kernel { name: "soft histogram, total", text: include_str!("histogram_total.wgsl") };
const BACKWARD: Kernel = Kernel { name: "soft histogram backward", text: include_str!("histogram_bwd.wgsl") };
const DIVERGENCE: Kernel = Kernel { name: "divergence from uniform", text: include_str!("divergence.wgsl") };

/// Values per workgroup of the shares.
const BLOCK: usize = 4096;
/// All invocations of a workgroup share one sum.
const LANES: (&str, u32) = ("LANES", WORKGROUP_SIZE as u32);

uniforms! {
    struct HistogramBlock as "Histogram" {
        len: u32,
        blocks: u32,
        bins: u32,
        low: f32,
        width: f32,
        share: f32,
    }
}

uniforms! {
    struct TotalBlock as "Total" {
        blocks: u32,
        bins: u32,
    }
}

uniforms! {
    struct DivergenceBlock as "Divergence" {
        bins: u32,
    }
}

impl SoftHistogram {
    fn block(&self, len: usize) -> HistogramBlock {
        let [low, width, share] = [self.low, self.width, 1.0 / len as f64].map(|number| number as f32);
        let [len, blocks, bins] = [len, len.div_ceil(BLOCK), self.bins].map(|size| size as u32);
        HistogramBlock { len, blocks, bins, low, width, share }
    }

    /// The shares.
    pub(super) fn shares_on_gpu<T: Real>(&self, gpu: Gpu, x: &Tensor<T>) -> Tensor<T> {
        let blocks = x.len().div_ceil(BLOCK);
        let block_shares = GpuArray::new(gpu, blocks * self.bins);
        let columns = self.bins.next_power_of_two().min(WORKGROUP_SIZE);
        let groups = blocks * self.bins.div_ceil(columns);
        let arrays = [Binding::Read(x.on_gpu(gpu)), Binding::Write(&block_shares)];
        BLOCKS.launch(gpu, &[("COLUMNS", columns as u32)], &self.block(x.len()), &arrays, groups);
        let shares = GpuArray::new(gpu, self.bins);
        let arrays = [Binding::Read(&block_shares), Binding::Write(&shares)];
        let block = TotalBlock { blocks: blocks as u32, bins: self.bins as u32 };
        TOTAL.launch(gpu, &[LANES], &block, &arrays, self.bins);
        Tensor::from_gpu([self.bins], shares)
    }

    /// The gradient of the values.
    pub(super) fn backward_on_gpu<T: Real>(&self, gpu: Gpu, x: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
        let gradient = GpuArray::new(gpu, x.len());
        let read = [x, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&read[..], &[Binding::Write(&gradient)]].concat();
        BACKWARD.launch(gpu, &[], &self.block(x.len()), &arrays, Groups::Over(gradient.len()));
        Tensor::from_gpu(x.shape(), gradient)
    }
}

/// Writes the divergence or, given its gradient, that of the shares.
fn launch_divergence<T: Real>(gpu: Gpu, shares: &Tensor<T>, dy: Option<&Tensor<T>>, out: &GpuArray) {
    // The shares are the placeholder of a missing gradient.
    let read = [shares, dy.unwrap_or(shares)].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let specialisation = [LANES, ("BACKWARD", u32::from(dy.is_some()))];
    let block = DivergenceBlock { bins: shares.len() as u32 };
    DIVERGENCE.launch(gpu, &specialisation, &block, &[&read[..], &[Binding::Write(out)]].concat(), 1);
}

pub(super) fn divergence<T: Real>(gpu: Gpu, shares: &Tensor<T>) -> Tensor<T> {
    let divergence = GpuArray::new(gpu, 1);
    launch_divergence(gpu, shares, None, &divergence);
    Tensor::from_gpu([1], divergence)
}

/// The gradient of the shares.
pub(super) fn divergence_backward<T: Real>(gpu: Gpu, shares: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
    let gradient = GpuArray::new(gpu, shares.len());
    launch_divergence(gpu, shares, Some(dy), &gradient);
    Tensor::from_gpu(shares.shape(), gradient)
}
