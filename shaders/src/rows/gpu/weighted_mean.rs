//! The weighted mean of squared differences on a GPU.

use crate::gpu::{Binding, Gpu, GpuArray, Kernel, ROW_SUM, in_windows, uniforms};
use crate::sums::{GROUP, LANES, add_rows};
use crate::tape::{Real, Tensor};

const SIZES: &str = include_str!("weighted.wgsl");
const TERMS: Kernel =
    Kernel { name: "weighted mean, terms", text: &[ROW_SUM, SIZES, include_str!("weighted_terms.wgsl")] };
const MEAN: Kernel = Kernel { name: "weighted mean", text: &[SIZES, include_str!("weighted_mean.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "weighted mean backward", text: &[SIZES, include_str!("weighted_mean_bwd.wgsl")] };

uniforms! {
    struct WeightedBlock as "Weighted" {
        rows: u32,
        columns: u32,
    }
}

/// What the backward pass needs of the forward pass.
pub struct WeightedMeanOnGpu {
    /// Σ w and Σ w‖a − b‖².
    sums: GpuArray,
}

impl WeightedBlock {
    /// So many rows of a.
    fn of<T: Real>(a: &Tensor<T>, rows: usize) -> Self {
        Self { rows: rows as u32, columns: a.row_len() as u32 }
    }
}

impl WeightedMeanOnGpu {
    /// The mean for a, b and weights.
    pub fn new<T: Real>(gpu: Gpu, inputs: &[&Tensor<T>]) -> (Self, Tensor<T>) {
        let rows = inputs[0].rows();
        let (sums, mean) = (GpuArray::new(gpu, 2), GpuArray::new(gpu, 1));
        let read: Vec<Binding> = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu))).collect();
        let mut adds = false;
        in_windows(gpu, rows, &read, |rows, read| {
            let groups = rows.div_ceil(GROUP);
            let terms = GpuArray::new(gpu, 2 * groups);
            let arrays = [read, &[Binding::Write(&terms)]].concat();
            TERMS.launch(gpu, &[LANES], &WeightedBlock::of(inputs[0], rows), &arrays, groups);
            add_rows(gpu, Binding::Read(&terms), [groups, 2], &sums, adds);
            adds = true;
        });
        let arrays = [Binding::Read(&sums), Binding::Write(&mean)];
        MEAN.launch(gpu, &[], &WeightedBlock::of(inputs[0], rows), &arrays, 1);
        (Self { sums }, Tensor::from_gpu([1], mean))
    }

    /// The gradients of a, b and weights.
    pub fn gradients<T: Real>(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        mean: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; 3] {
        let gradients = [0, 1, 2].map(|input| GpuArray::new(gpu, inputs[input].len()));
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let numbers = [mean.on_gpu(gpu), dy.on_gpu(gpu), &self.sums].map(|array| Binding::Read(array).all());
        let arrays: Vec<Binding> = read.chain(numbers).chain(gradients.iter().map(Binding::Write)).collect();
        in_windows(gpu, inputs[0].rows(), &arrays, |rows, arrays| {
            let groups = (rows * inputs[0].row_len()).div_ceil(GROUP);
            BACKWARD.launch(gpu, &[], &WeightedBlock::of(inputs[0], rows), arrays, groups);
        });
        let mut inputs = inputs.iter();
        gradients.map(|array| Tensor::from_gpu(inputs.next().expect("as many").shape(), array))
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout::assert_valid;
    assert_valid::<WeightedBlock>(&TERMS, &[LANES]);
    assert_valid::<WeightedBlock>(&MEAN, &[]);
    assert_valid::<WeightedBlock>(&BACKWARD, &[]);
}
