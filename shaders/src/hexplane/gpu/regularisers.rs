//! Means over planes: one launch for all of them.

use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, ROW_SUM, uniforms};
use crate::sums::{BLOCK, GROUP, LANES, total};
use crate::tape::{Real, Tensor, total_on_gpu};

const PLANE: &str = include_str!("plane.wgsl");
const SUMS: &str = include_str!("plane_sums.wgsl");
const GRADIENT: &str = include_str!("plane_gradient.wgsl");

/// The kernels of a mean over planes.
pub struct PlaneKernels {
    sums: Grouped,
    gradient: Grouped,
    /// Rows that have no term of the mean.
    rows_without: usize,
}

/// Of [`crate::hexplane::smoothness`].
pub const SMOOTHNESS: PlaneKernels = PlaneKernels {
    sums: sums("plane smoothness", &[ROW_SUM, PLANE, include_str!("smoothness.wgsl"), SUMS]),
    gradient: gradient("plane smoothness backward", &[PLANE, include_str!("smoothness.wgsl"), GRADIENT]),
    rows_without: 2,
};

/// Of [`crate::hexplane::distance_to_one`].
pub const DISTANCE: PlaneKernels = PlaneKernels {
    sums: sums("plane distance", &[ROW_SUM, PLANE, include_str!("distance.wgsl"), SUMS]),
    gradient: gradient("plane distance backward", &[PLANE, include_str!("distance.wgsl"), GRADIENT]),
    rows_without: 0,
};

const fn sums(name: &'static str, text: &'static [&'static str]) -> Grouped {
    Grouped { kernel: Kernel { name, text }, shared: 1, arrays: const { &[ItemArray::read("values")] } }
}

const fn gradient(name: &'static str, text: &'static [&'static str]) -> Grouped {
    let arrays = const { &[ItemArray::read("values"), ItemArray::write("gradient")] };
    Grouped { kernel: Kernel { name, text }, shared: 1, arrays }
}

uniforms! {
    struct PlaneItem as "Item" {
        rows: u32,
        row_len: u32,
        terms: u32,
        factor: f32,
        first_sum: u32,
        adds: u32,
    }
}

impl PlaneKernels {
    fn constants<T: Real>(&self, plane: &Tensor<T>, first_sum: usize, adds: bool) -> PlaneItem {
        let terms = plane.rows().saturating_sub(self.rows_without) * plane.row_len();
        let factor = if terms == 0 { 0.0 } else { 1.0 / terms as f32 };
        let [rows, row_len, terms, first_sum] =
            [plane.rows(), plane.row_len(), terms, first_sum].map(|size| size as u32);
        PlaneItem { rows, row_len, terms, factor, first_sum, adds: u32::from(adds) }
    }

    /// The sum over planes of the means: [1].
    pub fn sum_of_means<T: Real>(&self, gpu: Gpu, planes: &[&Tensor<T>]) -> Tensor<T> {
        let mut count = 0;
        let mut items = Vec::new();
        for plane in planes {
            let constants = self.constants(plane, count, false);
            let groups = (constants.terms as usize).div_ceil(BLOCK);
            count += groups;
            items.push(Item { constants, arrays: vec![Binding::Read(plane.on_gpu(gpu))], groups });
        }
        let sums = GpuArray::new(gpu, count);
        self.sums.launch(gpu, &[LANES], &[Binding::Write(&sums)], &items);
        Tensor::from_gpu([1], total(gpu, &sums, 1.0))
    }

    /// Adds dy times the gradients of the means to the totals of those planes that need one.
    pub fn add_gradients<T: Real>(
        &self,
        gpu: Gpu,
        planes: &[&Tensor<T>],
        dy: &Tensor<T>,
        needs: &[bool],
        totals: &mut [Option<Tensor<T>>],
    ) {
        let mut items = Vec::new();
        for ((plane, total), _) in planes.iter().zip(totals).zip(needs).filter(|(_, needed)| **needed) {
            let (gradient, adds) = total_on_gpu(gpu, total, plane.shape());
            let arrays = vec![Binding::Read(plane.on_gpu(gpu)), Binding::Write(gradient)];
            items.push(Item { constants: self.constants(plane, 0, adds), arrays, groups: plane.len().div_ceil(GROUP) });
        }
        self.gradient.launch(gpu, &[], &[Binding::Read(dy.on_gpu(gpu))], &items);
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::grouped::tests::assert_valid_grouped;
    for kernels in [SMOOTHNESS, DISTANCE] {
        assert_valid_grouped::<PlaneItem>(&kernels.sums, &[LANES]);
        assert_valid_grouped::<PlaneItem>(&kernels.gradient, &[]);
    }
}
