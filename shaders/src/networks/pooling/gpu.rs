//! The kernels of pooling.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::AveragePool;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const FORWARD: Kernel = Kernel { name: "average pool", text: include_str!("pooling.wgsl") };
const BACKWARD: Kernel = Kernel { name: "average pool backward", text: include_str!("pooling_bwd.wgsl") };

uniforms! {
    struct PoolBlock as "Pool" {
        pixels: [u32; 2],
        cells: [u32; 2],
        channels: u32,
        padding: u32,
    }
}

impl AveragePool {
    fn block(&self) -> PoolBlock {
        let axes = [self.vertical, self.horizontal];
        let (pixels, cells) = (axes.map(|axis| axis.pixels as u32), axes.map(|axis| axis.cells as u32));
        PoolBlock { pixels, cells, channels: self.channels as u32, padding: 0 }
    }

    pub(super) fn pool_on_gpu<T: Real>(&self, gpu: Gpu, image: &Tensor<T>) -> Tensor<T> {
        let shape = [self.vertical.cells, self.horizontal.cells, self.channels];
        let grid = GpuArray::new(gpu, shape.iter().product());
        let pixels_per_cell = image.len() / grid.len().max(1);
        let lanes = lanes_for(pixels_per_cell);
        let arrays = [Binding::Read(image.on_gpu(gpu)), Binding::Write(&grid)];
        let groups = Groups::Over(grid.len() * lanes);
        FORWARD.launch(gpu, &[("LANES", lanes as u32)], &self.block(), &arrays, groups);
        Tensor::from_gpu(shape, grid)
    }

    pub(super) fn backward_on_gpu<T: Real>(&self, gpu: Gpu, image: &Tensor<T>, dgrid: &Tensor<T>) -> Tensor<T> {
        let gradient = GpuArray::new(gpu, image.len());
        let arrays = [Binding::Read(dgrid.on_gpu(gpu)), Binding::Write(&gradient)];
        BACKWARD.launch(gpu, &[], &self.block(), &arrays, Groups::Over(gradient.len()));
        Tensor::from_gpu(image.shape(), gradient)
    }
}
