//! The kernels of attention to a window.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::WindowAttention;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const FORWARD: Kernel = Kernel { name: "window attention", text: include_str!("window_attention.wgsl") };
const BACKWARD: Kernel = Kernel { name: "window attention backward", text: include_str!("window_attention_bwd.wgsl") };
const LONG_FORWARD: Kernel =
    Kernel { name: "attention to long windows", text: include_str!("long_window_attention.wgsl") };
const LONG_BACKWARD: Kernel =
    Kernel { name: "attention to long windows backward", text: include_str!("long_window_attention_bwd.wgsl") };

/// The longest window that an invocation keeps in registers.
const MAX_WINDOW: usize = 32;

uniforms! {
    struct WindowBlock as "Window" {
        rows: u32,
        queries: u32,
        channels: u32,
        heads: u32,
        factor: f32,
    }
}

impl WindowAttention {
    /// Records the first kernel, or the second one for windows that are too long for it: `work` returns the
    /// invocations per row and the numbers per token of the window that each of them keeps.
    fn launch<T: Real>(
        &self,
        gpu: Gpu,
        [short, long]: [Kernel; 2],
        [queries, keys]: [&Tensor<T>; 2],
        arrays: &[Binding],
        work: impl Fn(&WindowBlock) -> [u32; 2],
    ) {
        let [of_queries, window] = [queries, keys].map(|tensor| tensor.row_len() / self.channels);
        let specialisation = [("WINDOW", window as u32)];
        let [of_queries, channels, heads] = [of_queries, self.channels, self.heads].map(|size| size as u32);
        let rows = queries.rows();
        let block = WindowBlock { rows: rows as u32, queries: of_queries, channels, heads, factor: self.factor() };
        let [per_row, numbers] = work(&block).map(|count| count as usize);
        let groups = Groups::Over(rows * per_row);
        if window <= MAX_WINDOW {
            return short.launch(gpu, &specialisation, &block, arrays, groups);
        }
        let held = GpuArray::new(gpu, rows * per_row * numbers * window);
        long.launch(gpu, &specialisation, &block, &[arrays, &[Binding::Write(&held)]].concat(), groups);
    }

    pub(super) fn value_on_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; 3]) -> Tensor<T> {
        let [queries, keys, _] = inputs;
        let y = GpuArray::new(gpu, queries.len());
        let read = inputs.map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays = [&read[..], &[Binding::Write(&y)]].concat();
        self.launch(gpu, [FORWARD, LONG_FORWARD], [queries, keys], &arrays, |block| [block.queries * block.heads, 1]);
        Tensor::from_gpu([queries.rows(), queries.row_len()], y)
    }

    pub(super) fn gradient_on_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; 3], dy: &Tensor<T>) -> [Tensor<T>; 3] {
        let [queries, keys, values] = inputs;
        let gradients = inputs.map(|input| GpuArray::new(gpu, input.len()));
        let read = [queries, keys, values, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&read[..], &gradients.each_ref().map(Binding::Write)].concat();
        self.launch(gpu, [BACKWARD, LONG_BACKWARD], [queries, keys], &arrays, |block| [block.heads, 2]);
        let [to_queries, to_keys, to_values] = gradients;
        let tensor = |array, input: &Tensor<T>| Tensor::from_gpu(input.shape(), array);
        [tensor(to_queries, queries), tensor(to_keys, keys), tensor(to_values, values)]
    }
}
