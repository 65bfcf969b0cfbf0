//! The draw on a GPU: a sort of all rows by their numbers, those that cannot be drawn last.

use super::{SampleSize, SampledRows};
use crate::arrays::rows::RowIndex;
use crate::arrays::sort::sort;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

pub(super) const KEYS: Kernel = Kernel { name: "sample, keys", text: include_str!("sample_keys.wgsl") };
pub(super) const CHOOSE: Kernel = Kernel { name: "sample", text: include_str!("sample.wgsl") };

uniforms! {
    pub(super) struct KeysBlock as "Keys" {
        rows: u32,
        seed: u32,
    }
}

uniforms! {
    pub(super) struct SampleBlock as "Sample" {
        rows: u32,
        places: u32,
        share: f32,
    }
}

pub(super) fn sample<T: Real>(gpu: Gpu, candidates: &Tensor<T>, size: SampleSize, seed: u32) -> SampledRows<T> {
    let (rows, places) = (candidates.len(), size.of(candidates.len()));
    let keys = GpuArray::new(gpu, rows);
    let block = KeysBlock { rows: rows as u32, seed };
    let arrays = [Binding::Read(candidates.on_gpu(gpu)), Binding::Write(&keys)];
    KEYS.launch(gpu, &[], &block, &arrays, Groups::Over(rows));
    let (sorted, order) = sort(gpu, &keys, u32::BITS);

    let [row_of_place, weights] = [(); 2].map(|()| GpuArray::new(gpu, places));
    let block = SampleBlock { rows: rows as u32, places: places as u32, share: size.share as f32 };
    let read = [&sorted, &order].map(Binding::Read);
    let arrays = [&read[..], &[&row_of_place, &weights].map(Binding::Write)].concat();
    CHOOSE.launch(gpu, &[], &block, &arrays, Groups::Over(places));
    SampledRows { rows: RowIndex::of_gpu(row_of_place, rows), weights: Tensor::from_gpu([places], weights) }
}
