//! The kernels of SSIM: one workgroup per tile of a channel filters along rows and columns in its own memory.

use super::{Layout, Ssim, TAPS, weights};
use crate::arrays::sums::{LANES, total};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const FORWARD: Kernel = Kernel { name: "ssim", text: include_str!("ssim.wgsl") };
const BACKWARD: Kernel = Kernel { name: "ssim backward", text: include_str!("ssim_bwd.wgsl") };

/// Pixels along the sides of a tile.
const TILE: usize = 16;

uniforms! {
    struct ImageBlock as "Image" {
        width: u32,
        height: u32,
        channels: u32,
        margin: u32,
        columns: u32,
        rows: u32,
        per_window: f32,
        padding: f32,
        weights: [[f32; 4]; 3],
    }
}

/// The specialisation of the kernels: whether derivatives are kept.
fn specialisation(keep: bool) -> [(&'static str, u32); 2] {
    [LANES, ("KEEP", u32::from(keep))]
}

impl ImageBlock {
    fn new(layout: &Layout) -> Self {
        let mut taps = [0.0; 12];
        taps[..TAPS].copy_from_slice(&weights::<f32>());
        let size = |size: usize| size as u32;
        Self {
            width: size(layout.width),
            height: size(layout.height),
            channels: size(layout.channels),
            margin: size(layout.margin()),
            columns: size(layout.width.div_ceil(TILE)),
            rows: size(layout.height.div_ceil(TILE)),
            per_window: 1.0 / layout.windows() as f32,
            padding: 0.0,
            weights: [0, 4, 8].map(|first| std::array::from_fn(|tap| taps[first + tap])),
        }
    }

    fn groups(&self) -> usize {
        self.columns as usize * self.rows as usize * self.channels as usize
    }
}

impl<T: Real> Ssim<T> {
    /// The mean, and the derivatives of every window where they are kept.
    pub(super) fn forward_on_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let block = ImageBlock::new(&self.layout);
        let sums = GpuArray::new(gpu, block.groups());
        let derivatives = GpuArray::new(gpu, if self.keep_gradients { 3 * inputs[0].len() } else { 1 });
        let read = [0, 1].map(|input| Binding::Read(inputs[input].on_gpu(gpu)));
        let arrays = [&read[..], &[&derivatives, &sums].map(Binding::Write)].concat();
        FORWARD.launch(gpu, &specialisation(self.keep_gradients), &block, &arrays, block.groups());
        self.on_gpu = self.keep_gradients.then_some(derivatives);
        Tensor::from_gpu([1], total(gpu, &sums, block.per_window))
    }

    /// The gradient of the render.
    pub(super) fn backward_on_gpu(&self, gpu: Gpu, inputs: &[&Tensor<T>], dy: &Tensor<T>) -> Tensor<T> {
        let block = ImageBlock::new(&self.layout);
        let gradients = self.on_gpu.as_ref().expect("the forward pass kept them");
        let dx = GpuArray::new(gpu, inputs[0].len());
        let read = [inputs[0].on_gpu(gpu), inputs[1].on_gpu(gpu), gradients, dy.on_gpu(gpu)];
        let arrays = [&read.map(Binding::Read)[..], &[Binding::Write(&dx)]].concat();
        BACKWARD.launch(gpu, &[], &block, &arrays, block.groups());
        Tensor::from_gpu(inputs[0].shape(), dx)
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use super::RADIUS;
    use crate::gpu::layout_tests::assert_valid;
    for keep in [false, true] {
        assert_valid::<ImageBlock>(&FORWARD, &specialisation(keep));
    }
    assert_valid::<ImageBlock>(&BACKWARD, &[]);
    let tile = include_str!("ssim_tile.wgsl");
    assert!(tile.contains(&format!("RADIUS: i32 = {RADIUS};")) && tile.contains(&format!("TILE: u32 = {TILE}u;")));
}
