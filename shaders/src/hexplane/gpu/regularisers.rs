//! Means over planes.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, ROW_SUM, uniforms};
use crate::sums::{BLOCK, GROUP, LANES, total};
use crate::tape::{Real, Tensor};

const PLANE: &str = include_str!("plane.wgsl");
const SUMS: &str = include_str!("plane_sums.wgsl");
const GRADIENT: &str = include_str!("plane_gradient.wgsl");

/// The kernels of a mean over a plane.
pub struct PlaneKernels {
    sums: Kernel,
    gradient: Kernel,
    /// Rows that have no term of the mean.
    rows_without: usize,
}

/// Of [`crate::hexplane::smoothness`].
pub const SMOOTHNESS: PlaneKernels = PlaneKernels {
    sums: Kernel { name: "plane smoothness", text: &[ROW_SUM, PLANE, include_str!("smoothness.wgsl"), SUMS] },
    gradient: Kernel { name: "plane smoothness backward", text: &[PLANE, include_str!("smoothness.wgsl"), GRADIENT] },
    rows_without: 2,
};

/// Of [`crate::hexplane::distance_to_one`].
pub const DISTANCE: PlaneKernels = PlaneKernels {
    sums: Kernel { name: "plane distance", text: &[ROW_SUM, PLANE, include_str!("distance.wgsl"), SUMS] },
    gradient: Kernel { name: "plane distance backward", text: &[PLANE, include_str!("distance.wgsl"), GRADIENT] },
    rows_without: 0,
};

uniforms! {
    struct PlaneBlock as "Plane" {
        rows: u32,
        row_len: u32,
        terms: u32,
        factor: f32,
        first_sum: u32,
    }
}

impl PlaneKernels {
    fn block<T: Real>(&self, plane: &Tensor<T>, first_sum: usize) -> PlaneBlock {
        let terms = plane.rows().saturating_sub(self.rows_without) * plane.row_len();
        let factor = if terms == 0 { 0.0 } else { 1.0 / terms as f32 };
        let [rows, row_len, terms, first_sum] =
            [plane.rows(), plane.row_len(), terms, first_sum].map(|size| size as u32);
        PlaneBlock { rows, row_len, terms, factor, first_sum }
    }

    /// The sum over planes of the means: [1].
    pub fn sum_of_means<T: Real>(&self, gpu: Gpu, planes: &[&Tensor<T>]) -> Tensor<T> {
        let mut count = 0;
        let block = |plane: &&Tensor<T>| {
            let block = self.block(plane, count);
            count += (block.terms as usize).div_ceil(BLOCK);
            block
        };
        let blocks: Vec<PlaneBlock> = planes.iter().map(block).collect();
        let sums = GpuArray::new(gpu, count);
        for (plane, block) in planes.iter().zip(&blocks) {
            let arrays = [Binding::Read(plane.on_gpu(gpu)), Binding::Write(&sums)];
            self.sums.launch(gpu, &[LANES], block, &arrays, (block.terms as usize).div_ceil(BLOCK));
        }
        Tensor::from_gpu([1], total(gpu, &sums, 1.0))
    }

    /// dy times the gradient of the mean over a plane.
    pub fn gradient<T: Real>(&self, gpu: Gpu, plane: &Tensor<T>, dy: &Tensor<T>) -> Tensor<T> {
        let gradient = GpuArray::new(gpu, plane.len());
        let arrays = [plane, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&arrays[..], &[Binding::Write(&gradient)]].concat();
        self.gradient.launch(gpu, &[], &self.block(plane, 0), &arrays, plane.len().div_ceil(GROUP));
        Tensor::from_gpu(plane.shape(), gradient)
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout::assert_valid;
    for kernels in [SMOOTHNESS, DISTANCE] {
        assert_valid::<PlaneBlock>(&kernels.sums, &[LANES]);
        assert_valid::<PlaneBlock>(&kernels.gradient, &[]);
    }
}
