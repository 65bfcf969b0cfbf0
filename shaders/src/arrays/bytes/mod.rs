//! Colours as bytes; colours on a GPU are converted there, because a quarter of the data is then read back.

#[cfg(test)]
mod tests;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::Tensor;

const BYTES: Kernel = Kernel { name: "bytes", text: include_str!("bytes.wgsl") };

uniforms! {
    struct ColorBlock as "Colors" {
        len: u32,
    }
}

/// Colours as bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// One per colour: clamped to [0, 1], times 255, rounded half up; 0 for NaN.
    pub values: Vec<u8>,
    /// Whether no colour is infinite or NaN.
    pub are_finite: bool,
}

/// The colours of a tensor as bytes. Where a product is just below or above a half, a GPU may round to the neighbour.
pub fn to_bytes(colors: &Tensor<f32>) -> Bytes {
    match colors.only_on_gpu() {
        Some(array) if !array.is_empty() => on_gpu(array.gpu(), array),
        _ => on_host(colors),
    }
}

fn on_host(colors: &Tensor<f32>) -> Bytes {
    let values = colors.as_slice().iter().map(|color| (color.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    Bytes { values, are_finite: colors.is_finite() }
}

fn on_gpu(gpu: Gpu, colors: &GpuArray) -> Bytes {
    let (len, words) = (colors.len(), colors.len().div_ceil(4));
    let (packed, others) = (GpuArray::new(gpu, words), GpuArray::zeros(gpu, 1));
    let arrays = [Binding::Read(colors), Binding::Write(&packed), Binding::Write(&others)];
    BYTES.launch(gpu, &[], &ColorBlock { len: len as u32 }, &arrays, Groups::Over(words));
    let mut read = GpuArray::read_all(&[&packed, &others]);
    let (others, packed) = (read.pop().expect("two arrays"), read.pop().expect("two arrays"));
    let mut values: Vec<u8> = packed.into_iter().flat_map(u32::to_le_bytes).collect();
    values.truncate(len);
    Bytes { values, are_finite: others[0] == 0 }
}
