//! The kernels of attention to a window.

#[cfg(test)]
mod tests;

use super::WindowAttention;
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const WINDOW: &str = include_str!("../window.wgsl");
const FORWARD: Kernel = Kernel { name: "window attention", text: &[WINDOW, include_str!("../window_attention.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "window attention backward", text: &[WINDOW, include_str!("../window_attention_bwd.wgsl")] };

/// Invocations per workgroup: few, because each holds the probabilities of its window.
const GROUP: usize = 64;
/// The longest window that has kernels.
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
    /// The constant of specialisation and the block of constants; `None` without a query and for windows of more than 32
    /// tokens.
    fn sizes<T: Real>(&self, queries: &Tensor<T>, keys: &Tensor<T>) -> Option<([(&'static str, u32); 1], WindowBlock)> {
        let [of_queries, window] = [queries, keys].map(|tensor| tensor.row_len() / self.channels);
        let sizes = [queries.rows(), of_queries, self.channels, self.heads].map(|size| size as u32);
        let [rows, queries, channels, heads] = sizes;
        let block = WindowBlock { rows, queries, channels, heads, factor: self.factor() };
        (of_queries > 0 && window <= MAX_WINDOW).then_some(([("WINDOW", window as u32)], block))
    }

    pub(super) fn value_on_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; 3]) -> Option<Tensor<T>> {
        let [queries, keys, _] = inputs;
        let (window, block) = self.sizes(queries, keys)?;
        let y = GpuArray::new(gpu, queries.len());
        let read = inputs.map(|input| Binding::Read(input.on_gpu(gpu)));
        let pairs = queries.len() / self.channels * self.heads;
        FORWARD.launch(gpu, &window, &block, &[&read[..], &[Binding::Write(&y)]].concat(), pairs.div_ceil(GROUP));
        Some(Tensor::from_gpu([queries.rows(), queries.row_len()], y))
    }

    pub(super) fn gradient_on_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: [&Tensor<T>; 3],
        dy: &Tensor<T>,
    ) -> Option<[Tensor<T>; 3]> {
        let [queries, keys, values] = inputs;
        let (window, block) = self.sizes(queries, keys)?;
        let gradients = inputs.map(|input| GpuArray::new(gpu, input.len()));
        let read = [queries, keys, values, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays = [&read[..], &gradients.each_ref().map(Binding::Write)].concat();
        BACKWARD.launch(gpu, &window, &block, &arrays, (queries.rows() * self.heads).div_ceil(GROUP));
        let [to_queries, to_keys, to_values] = gradients;
        let tensor = |array, input: &Tensor<T>| Tensor::from_gpu(input.shape(), array);
        Some([tensor(to_queries, queries), tensor(to_keys, keys), tensor(to_values, values)])
    }
}
