//! The kernels of binning.

use std::sync::Arc;

use super::{Grid, MAX_INTERSECTIONS};
use crate::arrays::sort::{SUM_CAP, sort, sort_first, sums_of};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, Length, uniforms};
use crate::tape::{Real, Tensor};

const COUNT: Kernel = Kernel { name: "binning, counts", text: include_str!("binning_count.wgsl") };
const RANK: Kernel = Kernel { name: "binning, ranks", text: include_str!("binning_rank.wgsl") };
const HITS: Kernel = Kernel { name: "binning, hits", text: include_str!("binning_hits.wgsl") };
const ENTRIES: Kernel = Kernel { name: "binning, entries", text: include_str!("binning_entries.wgsl") };

// A saturated sum must be detected as too large.
const _: () = assert!(SUM_CAP as u64 > MAX_INTERSECTIONS);

uniforms! {
    struct GridBlock as "Grid" {
        width: u32,
        height: u32,
        columns: u32,
        rows: u32,
        tiles: u32,
        count: u32,
        capacity: u32,
    }
}

uniforms! {
    struct EntriesBlock as "Entries" {
        tiles: u32,
    }
}

/// [`super::TileLists`] in GPU memory.
#[derive(Debug)]
pub struct GpuLists {
    pub(crate) grid: Grid,
    /// [1]: splats that some tile holds.
    pub(crate) visible: GpuArray,
    /// The number of entries, which is also that of hits; shared, so that a deferred readback need not keep the lists.
    pub(crate) entries: Arc<Length>,
    /// [N]: splats by rank; those that no tile holds come last.
    pub(crate) order: GpuArray,
    /// [N].
    pub(crate) rank_of_splat: GpuArray,
    /// [entries], with spare capacity.
    pub(crate) ranks: GpuArray,
    /// [tiles + 1].
    pub(crate) tile_starts: GpuArray,
    /// [hits], with spare capacity; `NO_RANK` for a hit that was counted and not found.
    pub(crate) entry_of_hit: GpuArray,
    /// [N + 1]: the first hit of every rank; a rank in no tile has no hits.
    pub(crate) hit_starts: GpuArray,
}

#[cfg(test)]
impl GpuLists {
    /// Copies the lists to the host.
    pub(crate) fn read_back(&self) -> super::TileLists {
        let read = |array: &GpuArray| {
            let mut out = vec![0; array.len()];
            array.read_into(&mut out);
            out
        };
        let sizes = |array: &GpuArray| read(array).into_iter().map(|start| start as usize).collect::<Vec<_>>();
        let (visible, entries) = (self.visible.read_one(0) as usize, self.entries.array().read_one(0) as usize);
        super::TileLists {
            grid: self.grid,
            order: read(&self.order)[..visible].to_vec(),
            rank_of_splat: read(&self.rank_of_splat),
            ranks: read(&self.ranks)[..entries].to_vec(),
            tile_starts: sizes(&self.tile_starts),
            entry_of_hit: read(&self.entry_of_hit)[..entries].to_vec(),
            hit_starts: sizes(&self.hit_starts)[..=visible].to_vec(),
        }
    }
}

impl GridBlock {
    fn new(grid: Grid, count: usize, capacity: usize) -> Self {
        let sizes = [grid.width, grid.height, grid.columns(), grid.rows(), grid.tiles(), count, capacity];
        let [width, height, columns, rows, tiles, count, capacity] = sizes.map(|size| size as u32);
        Self { width, height, columns, rows, tiles, count, capacity }
    }
}

/// Means, conics, depths and cutoffs of the splats.
type Inputs<'a, T> = [&'a Tensor<T>; 4];

/// The lists, in buffers with a capacity of this many intersections. Without a capacity, their number is read back first;
/// `None` if it exceeds [`MAX_INTERSECTIONS`].
pub(crate) fn tile_lists<T: Real>(
    gpu: Gpu,
    inputs: Inputs<T>,
    grid: Grid,
    capacity: Option<usize>,
) -> Option<GpuLists> {
    let [means2d, conics, depths, cutoffs] = inputs.map(|input| input.on_gpu(gpu));
    let ellipses = [means2d, conics, cutoffs].map(Binding::Read);
    let count = depths.len();

    // Depth order; splats that meet no tile come last.
    let (counts, keys) = (GpuArray::new(gpu, count), GpuArray::new(gpu, count));
    let arrays = [&ellipses[..], &[Binding::Read(depths), Binding::Write(&counts), Binding::Write(&keys)]].concat();
    COUNT.launch(gpu, &[], &GridBlock::new(grid, count, 0), &arrays, Groups::Over(count));
    let (sorted_keys, order) = sort(gpu, &keys, u32::BITS);

    // The number of tiles of each rank, and the start of its hits.
    let (rank_of_splat, visible) = (GpuArray::new(gpu, count), GpuArray::new(gpu, 1));
    let read = [&sorted_keys, &order, &counts].map(Binding::Read);
    let arrays = [&read[..], &[&rank_of_splat, &visible].map(Binding::Write)].concat();
    let hit_starts = sums_of(gpu, &RANK, &arrays, count + 1);

    let capacity = capacity.unwrap_or_else(|| hit_starts.read_one(count) as usize);
    if capacity as u64 > MAX_INTERSECTIONS {
        return None;
    }
    let entries = Arc::new(Length::new(gpu));
    let [hit_tiles, hit_ranks] = hits(gpu, &ellipses, grid, capacity, [&order, &hit_starts, entries.array()]);
    let [ranks, tile_starts, entry_of_hit] = by_tile(gpu, grid, &entries, [&hit_tiles, &hit_ranks]);
    Some(GpuLists { grid, visible, entries, order, rank_of_splat, ranks, tile_starts, entry_of_hit, hit_starts })
}

/// Tile and rank of every hit, up to the capacity; writes their number.
fn hits(
    gpu: Gpu,
    ellipses: &[Binding],
    grid: Grid,
    capacity: usize,
    [order, hit_starts, length]: [&GpuArray; 3],
) -> [GpuArray; 2] {
    let found = [(); 2].map(|()| GpuArray::new(gpu, capacity));
    let written = [&found[0], &found[1], length].map(Binding::Write);
    let arrays = [ellipses, &[order, hit_starts].map(Binding::Read), &written].concat();
    let count = order.len();
    HITS.launch(gpu, &[], &GridBlock::new(grid, count, capacity), &arrays, Groups::Over(count.max(1)));
    found
}

/// The ranks of the entries, where the tiles begin, and the entries of the hits.
fn by_tile(gpu: Gpu, grid: Grid, entries: &Length, [hit_tiles, hit_ranks]: [&GpuArray; 2]) -> [GpuArray; 3] {
    // The number of tiles encodes "no tile". The sort is stable: ranks keep their order within a tile.
    let bits = u32::BITS - (grid.tiles() as u32).leading_zeros();
    let (sorted_tiles, hit_of_entry) = sort_first(gpu, hit_tiles, Some(entries), bits);
    let lists = [hit_tiles.len(), grid.tiles() + 1, hit_tiles.len()].map(|len| GpuArray::new(gpu, len));
    let read = [entries.array(), &sorted_tiles, &hit_of_entry, hit_ranks].map(Binding::Read);
    let arrays = [&read[..], &lists.each_ref().map(Binding::Write)].concat();
    ENTRIES.launch(gpu, &[], &EntriesBlock { tiles: grid.tiles() as u32 }, &arrays, entries.groups());
    lists
}

#[cfg(test)]
#[test]
fn kernels_are_valid() {
    use crate::gpu::layout_tests::{Fields, check_layout};
    fn check<T: Fields>(kernel: &Kernel) {
        check_layout::<T>(&kernel.source(&[])).unwrap_or_else(|error| panic!("{}: {error}", kernel.name));
    }
    check::<GridBlock>(&COUNT);
    crate::arrays::sort::assert_valid_scan(&RANK);
    check::<GridBlock>(&HITS);
    check::<EntriesBlock>(&ENTRIES);
}
