//! The kernels of temporal harmonics.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::Waves;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const FORWARD: Kernel = Kernel { name: "temporal harmonics", text: include_str!("temporal_harmonics.wgsl") };
const BACKWARD: Kernel =
    Kernel { name: "temporal harmonics backward", text: include_str!("temporal_harmonics_bwd.wgsl") };

uniforms! {
    struct WavesBlock as "Waves" {
        time: f32,
        rows: u32,
        waves: u32,
        stored: u32,
        used: u32,
    }
}

impl Waves {
    fn block<T: Real>(&self, waves: &Tensor<T>) -> WavesBlock {
        let (rows, per_row) = (waves.rows(), waves.row_len() / self.stored);
        let [rows, waves, stored, used] = [rows, per_row, self.stored, self.used].map(|size| size as u32);
        WavesBlock { time: self.time as f32, rows, waves, stored, used }
    }

    pub(super) fn value_on_gpu<T: Real>(&self, gpu: Gpu, [waves, times]: [&Tensor<T>; 2]) -> Tensor<T> {
        let y = GpuArray::new(gpu, waves.rows() * self.used);
        let arrays = [Binding::Read(waves.on_gpu(gpu)), Binding::Read(times.on_gpu(gpu)), Binding::Write(&y)];
        FORWARD.launch(gpu, &[], &self.block(waves), &arrays, Groups::Over(y.len()));
        Tensor::from_gpu([waves.rows(), self.used], y)
    }

    pub(super) fn gradient_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        [waves, times]: [&Tensor<T>; 2],
        dy: &Tensor<T>,
    ) -> [Tensor<T>; 2] {
        let gradients = [waves, times].map(|input| GpuArray::new(gpu, input.len()));
        let read = [waves, times, dy].map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays = [&read[..], &gradients.each_ref().map(Binding::Write)].concat();
        let lanes = lanes_for(self.stored);
        let groups = Groups::Over(waves.rows() * lanes);
        BACKWARD.launch(gpu, &[("LANES", lanes as u32)], &self.block(waves), &arrays, groups);
        let [of_waves, of_times] = gradients;
        [Tensor::from_gpu(waves.shape(), of_waves), Tensor::from_gpu(times.shape(), of_times)]
    }
}
