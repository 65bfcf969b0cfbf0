//! The kernels of blending.

mod backward;
mod plan;
#[cfg(test)]
mod tests;

use super::{Blend, Constants};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::rasteriser::binning::{GpuLists, Grid};
use crate::rasteriser::settings::RasterSettings;
use crate::tape::{Real, Tensor};
pub use plan::PixelSums;
use plan::Plan;

const PACK: Kernel = Kernel { name: "blending, records", text: include_str!("../blending_pack.wgsl") };
const FORWARD: Kernel = Kernel { name: "blending", text: include_str!("../blending.wgsl") };

/// Entries of a tile that are staged at once: one for each invocation.
const BATCH: u32 = 256;
/// Elements of a splat's record.
const RECORD: usize = 12;

uniforms! {
    struct PackBlock as "Pack" {
        count: u32,
        features: u32,
    }
}

uniforms! {
    struct BlendBlock as "Blend" {
        background: [f32; 3],
        alpha_cap: f32,
        width: u32,
        height: u32,
        columns: u32,
        tiles: u32,
        stop: f32,
        alpha_threshold: f32,
        padding: [u32; 2],
    }
}

/// Values of the forward pass that the backward pass reads.
pub(super) struct Kept {
    /// [N, 12], by rank.
    records: GpuArray,
    /// [N, E], by rank.
    extras: GpuArray,
    /// [H, W], after the last splat.
    transmittances: GpuArray,
    /// [H, W]: entries of the tile up to the last that was blended.
    last_entries: GpuArray,
}

impl BlendBlock {
    fn new<T: Real>(constants: &Constants<T>, grid: Grid) -> Self {
        let f = |value: T| value.to_f64() as f32;
        Self {
            width: grid.width as u32,
            height: grid.height as u32,
            columns: grid.columns() as u32,
            tiles: grid.tiles() as u32,
            alpha_cap: f(constants.alpha_cap),
            stop: f(constants.stop),
            alpha_threshold: RasterSettings::ALPHA_THRESHOLD as f32,
            background: constants.background.map(f),
            padding: [0; 2],
        }
    }
}

impl<T: Real> Blend<T> {
    /// The specialisation of the kernels.
    fn specialisation(&self) -> [(&'static str, u32); 3] {
        let is_smooth = u32::from(self.constants.smooth_cutoff);
        [("EXTRAS", self.extra_count() as u32), ("DEPTH", self.depth_count as u32), ("SMOOTH", is_smooth)]
    }

    /// Depths and features, with a placeholder for each that is missing.
    fn extras_of<X: Copy>(&self, extras: &[X], otherwise: X) -> [X; 2] {
        let depth = if self.depth_count > 0 { extras[0] } else { otherwise };
        [depth, if self.feature_count > 0 { extras[self.depth_count] } else { otherwise }]
    }

    /// Colour, alpha and, where they are rendered, depth and features.
    pub(super) fn blend_on_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>], lists: &GpuLists) -> Vec<Tensor<T>> {
        let (grid, pixels) = (lists.grid, lists.grid.width * lists.grid.height);
        let (records, extras) = self.pack_on_gpu(gpu, inputs, lists);
        let [color, alpha, depth, features] =
            [3, 1, self.depth_count, self.feature_count].map(|channels| GpuArray::new(gpu, pixels * channels));
        let [transmittances, last_entries] = [(); 2].map(|()| GpuArray::new(gpu, pixels));
        let read = [&records, &extras, &lists.ranks, &lists.tile_starts].map(Binding::Read);
        let written = [&color, &alpha, &depth, &features, &transmittances, &last_entries].map(Binding::Write);
        let constants = BlendBlock::new(&self.constants, grid);
        let specialisation = [&self.specialisation()[..], &Plan::of(gpu).staging(BATCH)].concat();
        FORWARD.launch(gpu, &specialisation, &constants, &[&read[..], &written].concat(), grid.tiles());
        self.kept = Some(Kept { records, extras, transmittances, last_entries });

        let size = [grid.height, grid.width];
        let mut images = vec![Tensor::from_gpu([size[0], size[1], 3], color), Tensor::from_gpu(size, alpha)];
        images.extend((self.depth_count > 0).then(|| Tensor::from_gpu(size, depth)));
        let features_shape = [size[0], size[1], self.feature_count];
        images.extend((self.feature_count > 0).then(|| Tensor::from_gpu(features_shape, features)));
        images
    }

    /// The records and extras of all splats by rank; the number of visible splats stays on the GPU.
    fn pack_on_gpu(&self, gpu: Gpu, inputs: &[&Tensor<T>], lists: &GpuLists) -> (GpuArray, GpuArray) {
        let count = lists.order.len();
        let [records, extras] = [RECORD, self.extra_count()].map(|len| GpuArray::new(gpu, count * len));
        let [depths, features] = self.extras_of(&inputs[5..], inputs[4]);
        let read = inputs[..5].iter().chain([&depths, &features]).map(|input| Binding::Read(input.on_gpu(gpu)));
        let written = [Binding::Write(&records), Binding::Write(&extras)];
        let arrays: Vec<Binding> = [Binding::Read(&lists.order)].into_iter().chain(read).chain(written).collect();
        let constants = PackBlock { count: count as u32, features: self.feature_count as u32 };
        let [_, depth, _] = self.specialisation();
        PACK.launch(gpu, &[depth], &constants, &arrays, Groups::Over(count));
        (records, extras)
    }
}
