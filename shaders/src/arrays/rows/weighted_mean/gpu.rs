//! The weighted mean of squared differences on a GPU.

use crate::arrays::sums::{LANES, over_rows};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::{Real, Tensor};

const TERMS: Kernel = Kernel { name: "weighted mean, terms", text: include_str!("weighted_terms.wgsl") };
const MEAN: Kernel = Kernel { name: "weighted mean", text: include_str!("weighted_mean.wgsl") };
const BACKWARD: Kernel = Kernel { name: "weighted mean backward", text: include_str!("weighted_mean_bwd.wgsl") };

uniforms! {
    struct WeightedBlock as "Weighted" {
        rows: u32,
        columns: u32,
    }
}

/// Values of the forward pass that the backward pass reads.
pub(crate) struct WeightedMeanOnGpu {
    /// Σ w and Σ w‖a − b‖².
    sums: GpuArray,
}

impl WeightedBlock {
    fn of<T: Real>(a: &Tensor<T>) -> Self {
        Self { rows: a.rows() as u32, columns: a.row_len() as u32 }
    }
}

impl WeightedMeanOnGpu {
    /// The mean for a, b and weights.
    pub(super) fn new<T: Real>(gpu: Gpu, inputs: &[&Tensor<T>]) -> (Self, Tensor<T>) {
        let (block, groups) = (WeightedBlock::of(inputs[0]), inputs[0].rows().div_ceil(WORKGROUP_SIZE));
        let (terms, mean) = (GpuArray::new(gpu, 2 * groups), GpuArray::new(gpu, 1));
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain([Binding::Write(&terms)]).collect();
        TERMS.launch(gpu, &[LANES], &block, &arrays, groups);
        let sums = over_rows(gpu, &terms, 2);
        MEAN.launch(gpu, &[], &block, &[Binding::Read(&sums), Binding::Write(&mean)], 1);
        (Self { sums }, Tensor::from_gpu([1], mean))
    }

    /// The gradients of a, b and weights.
    pub(super) fn gradients<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        mean: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; 3] {
        let gradients = [0, 1, 2].map(|input| GpuArray::new(gpu, inputs[input].len()));
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let numbers = [mean.on_gpu(gpu), dy.on_gpu(gpu), &self.sums].map(Binding::Read);
        let arrays: Vec<Binding> = read.chain(numbers).chain(gradients.iter().map(Binding::Write)).collect();
        BACKWARD.launch(gpu, &[], &WeightedBlock::of(inputs[0]), &arrays, Groups::Over(inputs[0].len()));
        let mut inputs = inputs.iter();
        gradients.map(|array| Tensor::from_gpu(inputs.next().expect("as many").shape(), array))
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout_tests::assert_valid;
    assert_valid::<WeightedBlock>(&TERMS, &[LANES]);
    assert_valid::<WeightedBlock>(&MEAN, &[]);
    assert_valid::<WeightedBlock>(&BACKWARD, &[]);
}
