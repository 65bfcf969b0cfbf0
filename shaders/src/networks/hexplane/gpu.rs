//! The kernels of the field.
//!
//! The gradients of the planes are gathered, not scattered: points are sorted by the cell of each plane that they are in,
//! cells add their points block by block, and every texel adds the cells around it. A launch covers as many scales as the
//! adapter has array bindings for, and as many points as the scratch memory holds.

use super::Field;
use super::scales::{ScaleItem, cells, scales};
use crate::arrays::sort::{sort, starts};
use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{ALIGNMENT, Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, parts};
use crate::tape::{Real, Tensor, total_on_gpu};

const FORWARD: Grouped =
    Grouped { kernel: Kernel { name: "hexplane", text: include_str!("hexplane.wgsl") }, shared: 2, arrays: PLANES };
const BACKWARD: Grouped = Grouped {
    kernel: Kernel { name: "hexplane backward", text: include_str!("hexplane_bwd.wgsl") },
    shared: 4,
    arrays: PLANES,
};
const CELLS: Grouped =
    Grouped { kernel: Kernel { name: "hexplane, cells", text: include_str!("cells.wgsl") }, shared: 2, arrays: &[] };
const BLOCKS: Grouped =
    Grouped { kernel: Kernel { name: "hexplane, blocks", text: include_str!("blocks.wgsl") }, shared: 5, arrays: &[] };
const TEXELS: Grouped = Grouped {
    kernel: Kernel { name: "hexplane, texels", text: include_str!("texels.wgsl") },
    shared: 2,
    arrays: GRADIENTS,
};

/// The arrays of a scale: the six planes, or their gradients.
const PLANES: &[ItemArray] = &[
    ItemArray::read("plane_xy"),
    ItemArray::read("plane_xz"),
    ItemArray::read("plane_xt"),
    ItemArray::read("plane_yz"),
    ItemArray::read("plane_yt"),
    ItemArray::read("plane_zt"),
];
const GRADIENTS: &[ItemArray] = &[
    ItemArray::write("g_xy"),
    ItemArray::write("g_xz"),
    ItemArray::write("g_xt"),
    ItemArray::write("g_yz"),
    ItemArray::write("g_yt"),
    ItemArray::write("g_zt"),
];

/// Maximum number of gradients of values, 1 GiB: a step needs little more memory for millions of points than for a few.
const MOST_VALUES: usize = 1 << 28;
/// Entries of the list by cells that one invocation adds.
const ENTRIES_PER_BLOCK: usize = 32;

/// The items of scales that read their planes.
fn readers<'a, T: Real>(
    gpu: Gpu,
    scales: &[ScaleItem],
    planes: &[&'a Tensor<T>],
    groups: usize,
) -> Vec<Item<'a, ScaleItem>> {
    let array = |plane: &&'a Tensor<T>| Binding::Read(plane.on_gpu(gpu));
    let item = |(constants, planes): (&ScaleItem, &[&'a Tensor<T>])| Item {
        constants: *constants,
        arrays: planes.iter().map(array).collect(),
        groups,
    };
    scales.iter().zip(planes.chunks(6)).map(item).collect()
}

/// The items of scales without arrays.
fn bare<'a>(scales: &[ScaleItem], groups: usize) -> Vec<Item<'a, ScaleItem>> {
    scales.iter().map(|&constants| Item { constants, arrays: Vec::new(), groups }).collect()
}

/// Features [N, C·scales].
pub(super) fn forward<T: Real>(gpu: Gpu, field: &Field<T>, positions: &Tensor<T>) -> Tensor<T> {
    let (points, channels) = (positions.rows(), field.channels());
    let features = GpuArray::new(gpu, points * channels * field.scales());
    let shared = [Binding::Read(positions.on_gpu(gpu)), Binding::Write(&features)];
    let items = readers(gpu, &scales(field, points), field.planes, (points * channels).div_ceil(WORKGROUP_SIZE));
    FORWARD.launch(gpu, &[], &shared, &items);
    Tensor::from_gpu([points, channels * field.scales()], features)
}

/// Adds the gradients of positions and planes to their totals.
pub(crate) fn add_gradients<T: Real>(
    gpu: Gpu,
    field: &Field<T>,
    positions: &Tensor<T>,
    dy: &Tensor<T>,
    totals: &mut [Option<Tensor<T>>],
) {
    let (of_positions, of_planes) = totals.split_first_mut().expect("positions come first");
    let (g_positions, adds) = total_on_gpu(gpu, of_positions, positions.shape());
    let points = positions.rows();
    let [positions, dy] = [positions, dy].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let most = points_at_once(gpu, field);
    for first in (0..points).step_by(most) {
        let count = most.min(points - first);
        let [positions, dy, g_positions] = [positions, dy, Binding::Write(g_positions)].map(|array| {
            let columns = array.len() / points;
            array.within(columns * first, columns * count)
        });
        add_points(gpu, field, count, (positions, dy), (g_positions, adds), of_planes);
    }
}

/// The number of points whose value gradients fit into the scratch array, aligned so that the next points can follow.
fn points_at_once<T: Real>(gpu: Gpu, field: &Field<T>) -> usize {
    let per_point = 6 * field.scales() * field.channels();
    let fitting = parts::visible_len(gpu).min(MOST_VALUES) / per_point;
    (fitting / ALIGNMENT * ALIGNMENT).max(ALIGNMENT)
}

/// Adds the gradients of a range of points; position gradients are written or accumulated as the flag says.
fn add_points<T: Real>(
    gpu: Gpu,
    field: &Field<T>,
    points: usize,
    (positions, dy): (Binding, Binding),
    (g_positions, mut adds): (Binding, bool),
    of_planes: &mut [Option<Tensor<T>>],
) {
    let scales = scales(field, points);
    let list = CellList::new(gpu, &scales, positions);
    let most = scales_per_launch(gpu, &scales, field.planes);
    let parts = scales.chunks(most).zip(field.planes.chunks(6 * most)).zip(of_planes.chunks_mut(6 * most));
    for ((scales, planes), totals) in parts {
        let part = Part { gpu, scales, planes, positions, list: &list };
        let g_values = part.value_gradients(dy, g_positions, adds);
        part.add_to_planes(&part.corners(&g_values), totals);
        adds = true;
    }
}

/// The number of consecutive scales whose gradients one launch writes; at least one.
fn scales_per_launch<T: Real>(gpu: Gpu, scales: &[ScaleItem], planes: &[&Tensor<T>]) -> usize {
    let fits = |&count: &usize| {
        scales.chunks(count).zip(planes.chunks(6 * count)).all(|(scales, planes)| {
            let [points, values] = [scales[0].points(), scales[0].values(scales.len())];
            let features = points * scales[0].features as usize;
            let sum = |lens: &[usize]| lens.iter().map(|&len| parts::count(gpu, len)).sum::<usize>();
            let of_backward = sum(&[3 * points, 3 * points, features, values]);
            let of_texels = sum(&[cells(scales) + 1, corners(scales)]);
            let of_planes: usize = planes.iter().map(|plane| parts::count(gpu, plane.len())).sum();
            of_planes + of_backward.max(of_texels) <= gpu.arrays_per_kernel()
        })
    };
    let most = BACKWARD.capacity(gpu).min(TEXELS.capacity(gpu));
    (1..=most).rev().find(fits).unwrap_or(1)
}

/// The points of every cell of every plane.
struct CellList {
    /// [6·scales·points] in rising order.
    cells: GpuArray,
    /// Scale, plane and point of each.
    entries: GpuArray,
    /// [cells + 1].
    starts: GpuArray,
}

impl CellList {
    fn new(gpu: Gpu, scales: &[ScaleItem], positions: Binding) -> Self {
        let (cells, points) = (cells(scales), scales[0].points());
        let cell_of_entry = GpuArray::new(gpu, 6 * scales.len() * points);
        let shared = [positions, Binding::Write(&cell_of_entry)];
        CELLS.launch(gpu, &[], &shared, &bare(scales, points.div_ceil(WORKGROUP_SIZE)));
        let bits = usize::BITS - cells.saturating_sub(1).leading_zeros();
        let (sorted, entries) = sort(gpu, &cell_of_entry, bits);
        let starts = starts(gpu, &sorted, cells);
        Self { cells: sorted, entries, starts }
    }
}

/// Blocks of the list by cells, of the entries of these scales.
fn blocks(scales: &[ScaleItem]) -> usize {
    (6 * scales.len() * scales[0].points()).div_ceil(ENTRIES_PER_BLOCK)
}

/// Elements of the gradients of corners.
fn corners(scales: &[ScaleItem]) -> usize {
    4 * (blocks(scales) + cells(scales)) * scales[0].channels()
}

/// Consecutive scales whose gradients are computed together.
struct Part<'a, T: Real> {
    gpu: Gpu,
    scales: &'a [ScaleItem],
    planes: &'a [&'a Tensor<T>],
    positions: Binding<'a>,
    list: &'a CellList,
}

impl<T: Real> Part<'_, T> {
    /// The gradients of the values that the points read from the planes, [6·scales, N, C]; sums the gradients of the positions.
    fn value_gradients(&self, dy: Binding, g_positions: Binding, adds: bool) -> GpuArray {
        let (points, channels) = (self.scales[0].points(), self.scales[0].channels());
        let g_values = GpuArray::new(self.gpu, self.scales[0].values(self.scales.len()));
        let shared = [self.positions, dy, Binding::Write(&g_values), g_positions];
        let items = readers(self.gpu, self.scales, self.planes, 0);
        let groups = points.div_ceil((WORKGROUP_SIZE / channels).max(1));
        BACKWARD.launch_together(self.gpu, &[("ADDS", u32::from(adds))], &shared, &items, groups);
        g_values
    }

    /// The gradients of the corners of every cell, block by block.
    fn corners(&self, g_values: &GpuArray) -> GpuArray {
        let corners = GpuArray::new(self.gpu, corners(self.scales));
        let read = [g_values, &self.list.cells, &self.list.entries].map(Binding::Read);
        let shared = [&[self.positions][..], &read, &[Binding::Write(&corners)]].concat();
        let groups = (blocks(self.scales) * self.scales[0].channels()).div_ceil(WORKGROUP_SIZE);
        BLOCKS.launch_together(self.gpu, &[], &shared, &bare(self.scales, 0), groups);
        corners
    }

    /// Adds the gradients of the planes to their totals.
    fn add_to_planes(&self, corners: &GpuArray, totals: &mut [Option<Tensor<T>>]) {
        let mut items = bare(self.scales, 0);
        for ((item, planes), totals) in items.iter_mut().zip(self.planes.chunks(6)).zip(totals.chunks_mut(6)) {
            for (index, (plane, total)) in planes.iter().zip(totals).enumerate() {
                let (gradient, adds) = total_on_gpu(self.gpu, total, plane.shape());
                item.constants.adds |= u32::from(adds) << index;
                item.arrays.push(Binding::Write(gradient));
            }
            item.groups = planes.iter().map(|plane| plane.len()).sum::<usize>().div_ceil(WORKGROUP_SIZE);
        }
        let shared = [Binding::Read(&self.list.starts), Binding::Read(corners)];
        TEXELS.launch(self.gpu, &[], &shared, &items);
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::grouped::tests::assert_valid_grouped;
    for kernel in [&FORWARD, &CELLS, &BLOCKS, &TEXELS] {
        assert_valid_grouped::<ScaleItem>(kernel, &[]);
    }
    for adds in [0, 1] {
        assert_valid_grouped::<ScaleItem>(&BACKWARD, &[("ADDS", adds)]);
    }
    assert!(include_str!("field.wgsl").contains(&format!("ENTRIES_PER_BLOCK: u32 = {ENTRIES_PER_BLOCK}u;")));
}
