//! Colours as bytes; colours on a GPU are converted there, because a quarter of the data is then read back.

#[cfg(test)]
mod tests;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Device, PendingReadback, Readback, StartedReadback, Tape, Tensor};

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
    let started = StartedBytes::new(&mut Tape::new(Device::Cpu), colors);
    started.wait();
    started.finish().0
}

/// Colours that a GPU converts and copies to the host meanwhile, with the deferred counts of the tape that computed them.
pub struct StartedBytes {
    source: Source,
    readback: StartedReadback,
}

enum Source {
    Host(Tensor<f32>),
    /// The number of colours, which come with the readback.
    Gpu(usize),
}

impl StartedBytes {
    /// Submits everything recorded on a GPU and the conversion of these colours.
    pub fn new(tape: &mut Tape<f32>, colors: &Tensor<f32>) -> Self {
        let on_gpu = colors.only_on_gpu().filter(|array| !array.is_empty());
        let source = on_gpu.map_or_else(|| Source::Host(colors.clone()), |array| Source::Gpu(array.len()));
        let converted = on_gpu.map_or_else(Vec::new, |array| convert(array.gpu(), array).to_vec());
        Self { source, readback: PendingReadback::of(tape, converted).start() }
    }

    /// Waits until [`StartedBytes::finish`] does not wait for a GPU.
    pub fn wait(&self) {
        self.readback.wait();
    }

    /// The bytes and the counts, after [`StartedBytes::wait`].
    pub fn finish(self) -> (Bytes, Readback) {
        let mut readback = self.readback.finish();
        let bytes = match self.source {
            Source::Host(colors) => on_host(&colors),
            Source::Gpu(len) => {
                let [others, packed] = [(); 2].map(|()| readback.values.pop().expect("two tensors"));
                Bytes { values: bytemuck::cast_slice(&packed)[..len].to_vec(), are_finite: others[0].to_bits() == 0 }
            }
        };
        (bytes, readback)
    }
}

fn on_host(colors: &Tensor<f32>) -> Bytes {
    let values = colors.as_slice().iter().map(|color| (color.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    Bytes { values, are_finite: colors.is_finite() }
}

/// Four colours to an element, and 1 if a colour is infinite or NaN; both are integers.
fn convert(gpu: Gpu, colors: &GpuArray) -> [Tensor<f32>; 2] {
    let (len, words) = (colors.len(), colors.len().div_ceil(4));
    let (packed, others) = (GpuArray::new(gpu, words), GpuArray::zeros(gpu, 1));
    let arrays = [Binding::Read(colors), Binding::Write(&packed), Binding::Write(&others)];
    BYTES.launch(gpu, &[], &ColorBlock { len: len as u32 }, &arrays, Groups::Over(words));
    [Tensor::from_gpu([words], packed), Tensor::from_gpu([1], others)]
}
