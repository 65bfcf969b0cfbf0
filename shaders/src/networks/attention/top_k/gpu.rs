//! The kernels of attention to the best keys.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::TopK;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, WORKGROUP_SIZE, columns_for, uniforms};
use crate::tape::{Real, Tensor, upstream};

const CHOOSE: Kernel = Kernel { name: "top-k attention", text: include_str!("top_k_attention.wgsl") };
const MEAN: Kernel = Kernel { name: "top-k attention, mean", text: include_str!("top_k_attention_mean.wgsl") };
const BACKWARD: Kernel = Kernel { name: "top-k attention backward", text: include_str!("top_k_attention_bwd.wgsl") };
const KEYS_BACKWARD: Kernel =
    Kernel { name: "top-k attention backward, keys", text: include_str!("top_k_attention_keys_bwd.wgsl") };

const KEYS_GROUP: usize = 64;
/// All invocations of a workgroup share one sum.
const LANES: (&str, u32) = ("LANES", WORKGROUP_SIZE as u32);

uniforms! {
    struct TopKBlock as "TopK" {
        queries: u32,
        keys: u32,
        heads: u32,
        depth: u32,
        valid: u32,
        kept: u32,
        scale: f32,
    }
}

/// Values of the forward pass that the backward pass reads, [queries, heads, kept] each.
pub(super) struct Kept {
    /// Ascending within a query and head.
    chosen: GpuArray,
    probabilities: GpuArray,
}

impl<T: Real> TopK<T> {
    fn block(&self) -> TopKBlock {
        let layout = self.layout;
        let sizes = [layout.queries, layout.keys, layout.heads, layout.depth, self.valid.len(), self.kept];
        let [queries, keys, heads, depth, valid, kept] = sizes.map(|size| size as u32);
        TopKBlock { queries, keys, heads, depth, valid, kept, scale: layout.score_scale() }
    }

    fn columns(&self) -> (&'static str, u32) {
        ("COLUMNS", columns_for(self.layout.depth) as u32)
    }

    /// The attended values and the mean probabilities; `None` if no key is kept.
    pub(super) fn forward_on_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        if self.kept == 0 {
            return None;
        }
        let (layout, block) = (self.layout, self.block());
        let pairs = layout.queries * layout.heads;
        let valid = GpuArray::upload(gpu, &self.valid);
        let scores = GpuArray::new(gpu, pairs * self.valid.len());
        let [chosen, probabilities] = [(); 2].map(|()| GpuArray::new(gpu, pairs * self.kept));
        let mixed = GpuArray::new(gpu, layout.queries * layout.width());
        let read = inputs.iter().map(|input| input.on_gpu(gpu)).chain([&valid]).map(Binding::Read);
        let written = [&scores, &chosen, &probabilities, &mixed].map(Binding::Write);
        let arrays: Vec<Binding> = read.chain(written).collect();
        CHOOSE.launch(gpu, &[LANES, self.columns()], &block, &arrays, pairs);

        let mean = GpuArray::new(gpu, layout.queries * layout.keys);
        let arrays = [Binding::Read(&chosen), Binding::Read(&probabilities), Binding::Write(&mean)];
        MEAN.launch(gpu, &[], &block, &arrays, Groups::Over(mean.len()));
        self.on_gpu = Some(Kept { chosen, probabilities });
        let mixed = Tensor::from_gpu([layout.queries, layout.width()], mixed);
        Some(vec![mixed, Tensor::from_gpu([layout.queries, layout.keys], mean)])
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
    ) -> Vec<Option<Tensor<T>>> {
        let Kept { chosen, probabilities } = self.on_gpu.as_ref().expect("the forward pass kept them");
        let (layout, block) = (self.layout, self.block());
        let [query, key, value] = [0, 1, 2].map(|input| Binding::Read(inputs[input].on_gpu(gpu)));
        let kept = [chosen, probabilities].map(Binding::Read);
        let (mask, by_output) = upstream(gpu, output_grads, probabilities);
        let arriving = ("ARRIVING", mask);
        let g_scores = GpuArray::new(gpu, probabilities.len());
        let [to_query, to_key, to_value] = [0, 1, 2].map(|input| GpuArray::new(gpu, inputs[input].len()));
        let written = [&g_scores, &to_query].map(Binding::Write);
        let of_queries = [&[key, value][..], &kept, &by_output, &written].concat();
        let specialisation = [LANES, self.columns(), arriving];
        BACKWARD.launch(gpu, &specialisation, &block, &of_queries, layout.queries * layout.heads);

        let written = [&to_key, &to_value].map(Binding::Write);
        let of_keys = [&[query][..], &kept, &[Binding::Read(&g_scores)], &by_output[..1], &written].concat();
        let groups = layout.keys * layout.heads * (2 * layout.depth).div_ceil(KEYS_GROUP);
        KEYS_BACKWARD.launch(gpu, &[arriving], &block, &of_keys, groups);
        let gradients = [to_query, to_key, to_value].into_iter().zip(inputs);
        gradients.map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}
