//! The kernels of the backward pass.

use super::plan::Plan;
use super::{Blend, BlendBlock, Kept};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};
use crate::rasteriser::binning::GpuLists;
use crate::rasteriser::blending::ROW_COLORS;
use crate::tape::{Backward, Real, Tensor, upstream};

/// Subgroups sum pixels by shuffles.
pub(super) const IN_SUBGROUPS: Kernel =
    Kernel { name: "blending backward", text: include_str!("../blending_bwd_subgroups.wgsl") };
/// Pixels are summed in workgroup memory.
pub(super) const IN_WORKGROUPS: Kernel =
    Kernel { name: "blending backward", text: include_str!("../blending_bwd_shared.wgsl") };
pub(super) const SUM: Kernel = Kernel { name: "blending, sums", text: include_str!("../blending_sum.wgsl") };

/// The most columns of a splat that are added up side by side, by an invocation each.
const LARGEST_LANES: usize = 32;
/// Entries that are staged at once: one word of bits.
const LARGEST_BATCH: u32 = 32;
/// Partial rows in workgroup memory: 12 of the 16 KiB that every adapter has; staged entries use the rest.
const LARGEST_PARTS: usize = 3072;

uniforms! {
    pub(super) struct SumBlock as "Sum" {
        count: u32,
    }
}

/// The number of entries whose partial rows (one per subgroup) fit in workgroup memory; `None` if not even one fits.
pub(super) fn subgroup_batch(subgroup: u32, row_len: usize) -> Option<u32> {
    let parts_of_entry = WORKGROUP_SIZE / subgroup as usize * row_len;
    let fitting = u32::try_from(LARGEST_PARTS / parts_of_entry).expect("a few");
    (fitting > 0).then(|| LARGEST_BATCH.min(1 << fitting.ilog2()))
}

/// The kernel that computes the rows, and its specialisation.
fn adding_up(plan: Plan, row_len: usize) -> (&'static Kernel, Vec<(&'static str, u32)>) {
    let in_workgroups = (&IN_WORKGROUPS, plan.staging(LARGEST_BATCH).to_vec());
    let Some(subgroup) = plan.subgroup else { return in_workgroups };
    match subgroup_batch(subgroup, row_len) {
        Some(batch) => (&IN_SUBGROUPS, [&plan.staging(batch)[..], &[("SUBGROUP", subgroup)]].concat()),
        None => in_workgroups,
    }
}

impl<T: Real> Blend<T> {
    /// The gradients of all inputs except the cutoffs, which have none.
    pub(in crate::rasteriser::blending) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        pass: Backward<T>,
        lists: &GpuLists,
    ) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, output_grads, .. } = pass;
        let count = inputs[0].rows();
        // Gradients of extras are allocated even without extras: every binding of a kernel must exist.
        let [depth_len, features_len] = [count * self.depth_count, count * self.feature_count];
        let lens = [2 * count, 3 * count, count, 3 * count, depth_len, features_len];
        let gradients = lens.map(|len| GpuArray::new(gpu, len));

        // The capacity of the lists may exceed the number of entries; rows past the last entry are neither written nor read.
        let rows = GpuArray::new(gpu, lists.ranks.len() * self.row_len());
        self.write_rows(gpu, (outputs, output_grads), lists, &rows);
        self.add_rows(gpu, inputs, lists, &rows, &gradients);

        let [means2d, conics, opacities, colors, depths, features] = gradients;
        let mut gradients = vec![Some(means2d), Some(conics), Some(opacities), Some(colors), None];
        gradients.extend((self.depth_count > 0).then_some(Some(depths)));
        gradients.extend((self.feature_count > 0).then_some(Some(features)));
        let tensor = |(array, input): (Option<GpuArray>, &&Tensor<T>)| Some(Tensor::from_gpu(input.shape(), array?));
        gradients.into_iter().zip(inputs).map(tensor).collect()
    }

    /// Columns of a row.
    fn row_len(&self) -> usize {
        ROW_COLORS + 3 + self.extra_count()
    }

    /// [entries, row]: the sums of every (tile, splat).
    fn write_rows(
        &self,
        gpu: Gpu,
        (outputs, output_grads): (&[&Tensor<T>], &[Option<&Tensor<T>>]),
        lists: &GpuLists,
        rows: &GpuArray,
    ) {
        if rows.is_empty() {
            return;
        }
        let Kept { records, extras, transmittances, last_entries } = self.kept.as_ref().expect("forward has run");
        let color = outputs[0].on_gpu(gpu);
        let [depth, features] = self.extras_of(&outputs[2..], outputs[0]).map(|output| output.on_gpu(gpu));
        let [g_depth, g_features] = self.extras_of(&output_grads[2..], None);
        let (mask, gradients) = upstream(gpu, &[output_grads[0], output_grads[1], g_depth, g_features], color);
        let read = [records, extras, &lists.ranks, &lists.tile_starts, transmittances, last_entries];
        let read = read.into_iter().chain([color, depth, features]).map(Binding::Read);
        let arrays: Vec<Binding> = read.chain(gradients).chain([Binding::Write(rows)]).collect();
        let (kernel, adding) = adding_up(Plan::of(gpu), self.row_len());
        let specialisation = [&self.specialisation()[..], &adding, &[("ARRIVING", mask)]].concat();
        let constants = BlendBlock::new(&self.constants, lists.grid);
        kernel.launch(gpu, &specialisation, &constants, &arrays, lists.grid.tiles());
    }

    /// Adds the rows of every splat, and converts them to gradients.
    fn add_rows(&self, gpu: Gpu, inputs: &[&Tensor<T>], lists: &GpuLists, rows: &GpuArray, gradients: &[GpuArray]) {
        let read = [rows, &lists.entry_of_hit, &lists.hit_starts, &lists.rank_of_splat];
        let shapes = [inputs[1].on_gpu(gpu), inputs[2].on_gpu(gpu)];
        let read = read.into_iter().chain(shapes).map(Binding::Read);
        let arrays: Vec<Binding> = read.chain(gradients.iter().map(Binding::Write)).collect();
        let (count, lanes) = (inputs[0].rows(), self.row_len().min(LARGEST_LANES));
        let constants = SumBlock { count: count as u32 };
        let [extras, depth, _] = self.specialisation();
        let specialisation = [extras, depth, ("LANES", lanes as u32)];
        SUM.launch(gpu, &specialisation, &constants, &arrays, count.div_ceil(WORKGROUP_SIZE / lanes));
    }
}
