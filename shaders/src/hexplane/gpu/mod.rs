//! The kernels of the field and of its regularisers.
//!
//! The gradients of the planes are gathered, not scattered: points are sorted by the cell of each plane that they are in,
//! cells add their points block by block, and every texel adds the cells around it.

mod regularisers;

pub use regularisers::{DISTANCE, PlaneKernels, SMOOTHNESS};

use super::lookup::Lookup;
use super::{Field, PAIRS, TIME};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::sort::{sort, starts};
use crate::tape::{Real, Tensor};

const FIELD: &str = include_str!("field.wgsl");
const POINTS: &str = include_str!("points.wgsl");
const FORWARD: Kernel = Kernel { name: "hexplane", text: &[FIELD, POINTS, include_str!("../hexplane.wgsl")] };
const BACKWARD: Kernel =
    Kernel { name: "hexplane backward", text: &[FIELD, POINTS, include_str!("../hexplane_bwd.wgsl")] };
const CELLS: Kernel = Kernel { name: "hexplane, cells", text: &[FIELD, include_str!("cells.wgsl")] };
const BLOCKS: Kernel = Kernel { name: "hexplane, blocks", text: &[FIELD, include_str!("blocks.wgsl")] };
const TEXELS: Kernel = Kernel { name: "hexplane, texels", text: &[FIELD, include_str!("texels.wgsl")] };

/// Invocations per workgroup; channels up to which a workgroup of the backward pass has whole points.
const GROUP: usize = 256;
/// Entries of the list by cells that one invocation adds.
const ENTRIES_PER_BLOCK: usize = 32;

uniforms! {
    struct ScaleBlock as "Scale" {
        resolution: [u32; 4],
        cell_starts: [[u32; 4]; 2],
        points: u32,
        channels: u32,
        features: u32,
        first_feature: u32,
        time_low: u32,
        time_high: u32,
        time_fraction: f32,
        first_entry: u32,
    }
}

/// The constants of every scale, and the number of cells of all planes.
fn scales<T: Real>(field: &Field<T>, points: usize) -> (Vec<ScaleBlock>, usize) {
    let (channels, mut cells) = (field.channels(), 0);
    let scale = |scale: usize| {
        let resolution = field.resolution(scale);
        let time = Lookup::new(field.time.to_f64() as f32, resolution[TIME]);
        let along = |axis: usize| resolution[axis].max(2) - 1;
        let mut cell_starts = [0; 8];
        for (plane, (a, b)) in PAIRS.into_iter().enumerate() {
            cell_starts[plane] = cells as u32;
            cells += along(a) * if b == TIME { 1 } else { along(b) };
        }
        cell_starts[6] = cells as u32;
        ScaleBlock {
            resolution: resolution.map(|texels| texels as u32),
            cell_starts: [0, 4].map(|first| std::array::from_fn(|plane| cell_starts[first + plane])),
            points: points as u32,
            channels: channels as u32,
            features: (channels * field.scales()) as u32,
            first_feature: (scale * channels) as u32,
            time_low: time.low as u32,
            time_high: time.high as u32,
            time_fraction: time.fraction,
            first_entry: (6 * scale * points) as u32,
        }
    };
    let scales = (0..field.scales()).map(scale).collect();
    (scales, cells)
}

impl ScaleBlock {
    fn cells(&self) -> usize {
        (self.cell_starts[1][2] - self.cell_starts[0][0]) as usize
    }
}

/// Positions and the six planes of a scale.
fn read<'a, T: Real>(gpu: Gpu, positions: &'a Tensor<T>, planes: &[&'a Tensor<T>]) -> Vec<Binding<'a>> {
    [positions].iter().chain(planes).map(|tensor| Binding::Read(tensor.on_gpu(gpu))).collect()
}

/// Features [N, C·scales]; `None` for more channels than a workgroup has invocations.
pub fn forward<T: Real>(gpu: Gpu, field: &Field<T>, positions: &Tensor<T>) -> Option<Tensor<T>> {
    let (points, channels) = (positions.rows(), field.channels());
    if channels > GROUP {
        return None;
    }
    let features = GpuArray::new(gpu, points * channels * field.scales());
    for (block, planes) in scales(field, points).0.iter().zip(field.planes.chunks(6)) {
        let mut arrays = read(gpu, positions, planes);
        arrays.push(Binding::Write(&features));
        FORWARD.launch(gpu, &[], block, &arrays, (points * channels).div_ceil(GROUP));
    }
    Some(Tensor::from_gpu([points, channels * field.scales()], features))
}

/// The gradients of positions and planes; `None` where [`forward`] is.
pub fn backward<T: Real>(gpu: Gpu, field: &Field<T>, positions: &Tensor<T>, dy: &Tensor<T>) -> Option<Vec<Tensor<T>>> {
    if field.channels() > GROUP {
        return None;
    }
    let points = positions.rows();
    let (scales, cells) = scales(field, points);
    let list = CellList::new(gpu, &scales, cells, positions);
    let g_positions = GpuArray::new(gpu, positions.len());
    let mut g_planes = Vec::new();
    for (index, (block, planes)) in scales.iter().zip(field.planes.chunks(6)).enumerate() {
        let g_values = GpuArray::new(gpu, 6 * points * field.channels());
        let mut arrays = read(gpu, positions, planes);
        arrays.push(Binding::Read(dy.on_gpu(gpu)));
        arrays.extend([&g_values, &g_positions].map(Binding::Write));
        let groups = points.div_ceil(GROUP / field.channels());
        BACKWARD.launch(gpu, &[("FIRST", u32::from(index == 0))], block, &arrays, groups);
        let corners = list.corners(gpu, block, positions, &g_values);
        g_planes.extend(list.planes(gpu, block, planes, &corners));
    }
    Some([Tensor::from_gpu(positions.shape(), g_positions)].into_iter().chain(g_planes).collect())
}

/// The points of every cell of every plane.
struct CellList {
    /// [6·scales·points] in rising order.
    cells: GpuArray,
    /// Plane and point of each.
    entries: GpuArray,
    /// [cells + 1].
    starts: GpuArray,
}

impl CellList {
    fn new<T: Real>(gpu: Gpu, scales: &[ScaleBlock], cells: usize, positions: &Tensor<T>) -> Self {
        let points = positions.rows();
        let cell_of_entry = GpuArray::new(gpu, 6 * scales.len() * points);
        for block in scales {
            let arrays = [Binding::Read(positions.on_gpu(gpu)), Binding::Write(&cell_of_entry)];
            CELLS.launch(gpu, &[], block, &arrays, points.div_ceil(GROUP));
        }
        let (sorted, entries) = sort(gpu, &cell_of_entry, usize::BITS - cells.leading_zeros());
        let starts = starts(gpu, &sorted, cells);
        Self { cells: sorted, entries, starts }
    }

    /// The gradients of the corners of every cell of a scale, block by block.
    fn corners<T: Real>(&self, gpu: Gpu, block: &ScaleBlock, positions: &Tensor<T>, g_values: &GpuArray) -> GpuArray {
        let (points, channels) = (block.points as usize, block.channels as usize);
        let blocks = (6 * points).div_ceil(ENTRIES_PER_BLOCK);
        let corners = GpuArray::new(gpu, 4 * (blocks + block.cells()) * channels);
        let read = [positions.on_gpu(gpu), g_values, &self.cells, &self.entries].map(Binding::Read);
        let arrays = [&read[..], &[Binding::Write(&corners)]].concat();
        BLOCKS.launch(gpu, &[], block, &arrays, (blocks * channels).div_ceil(GROUP));
        corners
    }

    /// The gradients of the six planes of a scale.
    fn planes<T: Real>(
        &self,
        gpu: Gpu,
        block: &ScaleBlock,
        planes: &[&Tensor<T>],
        corners: &GpuArray,
    ) -> Vec<Tensor<T>> {
        let gradients: Vec<GpuArray> = planes.iter().map(|plane| GpuArray::new(gpu, plane.len())).collect();
        let mut arrays = vec![Binding::Read(&self.starts), Binding::Read(corners)];
        arrays.extend(gradients.iter().map(Binding::Write));
        let elements: usize = gradients.iter().map(GpuArray::len).sum();
        TEXELS.launch(gpu, &[], block, &arrays, elements.div_ceil(GROUP));
        gradients.into_iter().zip(planes).map(|(array, plane)| Tensor::from_gpu(plane.shape(), array)).collect()
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout::assert_valid;
    for kernel in [&FORWARD, &CELLS, &BLOCKS, &TEXELS] {
        assert_valid::<ScaleBlock>(kernel, &[]);
    }
    for first in [0, 1] {
        assert_valid::<ScaleBlock>(&BACKWARD, &[("FIRST", first)]);
    }
    assert!(FIELD.contains(&format!("ENTRIES_PER_BLOCK: u32 = {ENTRIES_PER_BLOCK}u;")));
}
