//! The kernels of binning.

use super::{Grid, MAX_INTERSECTIONS};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, uniforms};
use crate::sort::{SUM_CAP, exclusive_sums, sort};
use crate::tape::{Real, Tensor};

const GROUP: usize = 256;
const SPANS: &str = concat!(include_str!("ellipse.wgsl"), include_str!("tile_spans.wgsl"));
const COUNT: Kernel = Kernel { name: "binning, counts", text: &[SPANS, include_str!("binning_count.wgsl")] };
const RANK: Kernel = Kernel { name: "binning, ranks", text: &[include_str!("binning_rank.wgsl")] };
const HITS: Kernel = Kernel { name: "binning, hits", text: &[SPANS, include_str!("binning_hits.wgsl")] };
const ENTRIES: Kernel = Kernel { name: "binning, entries", text: &[include_str!("binning_entries.wgsl")] };

// A sum that saturates must count as too many.
const _: () = assert!(SUM_CAP as u64 > MAX_INTERSECTIONS);

uniforms! {
    struct GridBlock as "Grid" {
        width: u32,
        height: u32,
        columns: u32,
        rows: u32,
        tiles: u32,
        count: u32,
    }
}

uniforms! {
    struct RanksBlock as "Ranks" {
        count: u32,
    }
}

uniforms! {
    struct EntriesBlock as "Entries" {
        count: u32,
        tiles: u32,
    }
}

/// As [`super::TileLists`], in the memory of a GPU.
#[derive(Debug)]
pub struct GpuLists {
    pub grid: Grid,
    /// Splats that some tile holds.
    pub visible: usize,
    /// [N]: splats by rank; those that no tile holds come last.
    pub order: GpuArray,
    /// [N].
    pub rank_of_splat: GpuArray,
    /// [entries].
    pub ranks: GpuArray,
    /// [tiles + 1].
    pub tile_starts: GpuArray,
    /// [hits]; `NO_RANK` for a hit that was counted and not found.
    pub entry_of_hit: GpuArray,
    /// [N + 1]: where the hits of a rank begin; ranks that no tile holds have none.
    pub hit_starts: GpuArray,
}

#[cfg(test)]
impl GpuLists {
    /// The same lists in the host's memory.
    pub fn read_back(&self) -> super::TileLists {
        let read = |array: &GpuArray| {
            let mut out = vec![0; array.len()];
            array.read_into(&mut out);
            out
        };
        let sizes = |array: &GpuArray| read(array).into_iter().map(|start| start as usize).collect::<Vec<_>>();
        super::TileLists {
            grid: self.grid,
            order: read(&self.order)[..self.visible].to_vec(),
            rank_of_splat: read(&self.rank_of_splat),
            ranks: read(&self.ranks),
            tile_starts: sizes(&self.tile_starts),
            entry_of_hit: read(&self.entry_of_hit),
            hit_starts: sizes(&self.hit_starts)[..=self.visible].to_vec(),
        }
    }
}

impl GridBlock {
    fn new(grid: Grid, count: usize) -> Self {
        let [width, height, columns, rows, tiles, count] =
            [grid.width, grid.height, grid.columns(), grid.rows(), grid.tiles(), count].map(|value| value as u32);
        Self { width, height, columns, rows, tiles, count }
    }
}

/// Means, conics, depths and cutoffs of the splats.
type Inputs<'a, T> = [&'a Tensor<T>; 4];

/// The lists, or `None` if there are too many intersections.
pub fn tile_lists<T: Real>(gpu: Gpu, inputs: Inputs<T>, grid: Grid) -> Option<GpuLists> {
    let [means2d, conics, depths, cutoffs] = inputs.map(|input| input.on_gpu(gpu));
    let ellipses = [means2d, conics, cutoffs].map(Binding::Read);
    let count = depths.len();

    // Depth order, in which those that meet no tile come last.
    let (counts, keys) = (GpuArray::new(gpu, count), GpuArray::new(gpu, count));
    let arrays = [&ellipses[..], &[Binding::Read(depths), Binding::Write(&counts), Binding::Write(&keys)]].concat();
    COUNT.launch(gpu, &[], &GridBlock::new(grid, count), &arrays, count.div_ceil(GROUP));
    let (sorted_keys, order) = sort(gpu, &keys, u32::BITS);

    // What each rank meets, and where it begins.
    let (rank_of_splat, counts_of_ranks) = (GpuArray::new(gpu, count), GpuArray::new(gpu, count + 1));
    let visible = GpuArray::new(gpu, 1);
    let arrays = [
        Binding::Read(&sorted_keys),
        Binding::Read(&order),
        Binding::Read(&counts),
        Binding::Write(&rank_of_splat),
        Binding::Write(&counts_of_ranks),
        Binding::Write(&visible),
    ];
    RANK.launch(gpu, &[], &RanksBlock { count: count as u32 }, &arrays, (count + 1).div_ceil(GROUP));
    let hit_starts = exclusive_sums(gpu, &counts_of_ranks);

    // How much there is decides what is allocated: the one thing that is read back.
    let [visible, hits] = [(&visible, 0), (&hit_starts, count)].map(|(array, at)| array.read_one(at) as usize);
    if hits as u64 > MAX_INTERSECTIONS {
        return None;
    }
    let (ranks, tile_starts, entry_of_hit) = entries(gpu, &ellipses, grid, count, hits, &order, &hit_starts);
    Some(GpuLists { grid, visible, order, rank_of_splat, ranks, tile_starts, entry_of_hit, hit_starts })
}

/// The ranks of the entries, where the tiles begin, and the entries of the hits.
fn entries(
    gpu: Gpu,
    ellipses: &[Binding],
    grid: Grid,
    count: usize,
    hits: usize,
    order: &GpuArray,
    hit_starts: &GpuArray,
) -> (GpuArray, GpuArray, GpuArray) {
    let [hit_tiles, hit_ranks, ranks, entry_of_hit] = [(); 4].map(|()| GpuArray::new(gpu, hits));
    if hits == 0 {
        return (ranks, GpuArray::upload(gpu, &vec![0_u32; grid.tiles() + 1]), entry_of_hit);
    }
    let places = [Binding::Read(order), Binding::Read(hit_starts)];
    let found = [Binding::Write(&hit_tiles), Binding::Write(&hit_ranks)];
    let arrays = [ellipses, &places, &found].concat();
    HITS.launch(gpu, &[], &GridBlock::new(grid, count), &arrays, count.div_ceil(GROUP));

    // By tile; the number of tiles stands for none. The order of ranks within a tile stays.
    let bits = u32::BITS - (grid.tiles() as u32).leading_zeros();
    let (sorted_tiles, hit_of_entry) = sort(gpu, &hit_tiles, bits);
    let tile_starts = GpuArray::new(gpu, grid.tiles() + 1);
    let arrays = [
        Binding::Read(&sorted_tiles),
        Binding::Read(&hit_of_entry),
        Binding::Read(&hit_ranks),
        Binding::Write(&ranks),
        Binding::Write(&entry_of_hit),
        Binding::Write(&tile_starts),
    ];
    let constants = EntriesBlock { count: hits as u32, tiles: grid.tiles() as u32 };
    ENTRIES.launch(gpu, &[], &constants, &arrays, hits.div_ceil(GROUP));
    (ranks, tile_starts, entry_of_hit)
}

#[cfg(test)]
#[test]
fn kernels_are_valid() {
    use crate::gpu::layout::{Fields, check_layout};
    fn check<T: Fields>(kernel: &Kernel) {
        check_layout::<T>(&kernel.source(&[])).unwrap_or_else(|error| panic!("{}: {error}", kernel.name));
    }
    check::<GridBlock>(&COUNT);
    check::<RanksBlock>(&RANK);
    check::<GridBlock>(&HITS);
    check::<EntriesBlock>(&ENTRIES);
}
