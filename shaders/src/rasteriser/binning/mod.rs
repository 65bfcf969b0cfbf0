//! The splats that each tile of the image blends, front to back.
//!
//! Splats are ordered by depth (rounded to f32), equal depths by index. A splat's alpha at a
//! pixel is opacity·e^(−σ), with σ half the squared Mahalanobis distance from its mean; `cutoff` = ln(255·opacity). A tile
//! holds a splat iff the ellipse σ ≤ cutoff meets the rectangle spanned by the tile's pixel centres: the test is exact up to
//! rounding, where it errs towards inclusion. After one pass over the ellipses, all passes use only integer spans of tiles,
//! so that counts and lists agree.

mod ellipse;
mod gpu;
#[cfg(test)]
mod tests;

use std::fmt;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::rasteriser::projection::ProjectedVars;
use crate::tape::{Backward, DeferredCount, GpuOp, Op, Real, Tape, Tensor, chunks, exactly};
use ellipse::Ellipse;
pub use gpu::GpuLists;

/// Tiles are squares of this many pixels: a row is one vector of 16 lanes.
pub(crate) const TILE: usize = 16;

/// Intersections per render above which it is refused: at least 9 GiB of gradient rows in f32, far below overflow of u32.
pub const MAX_INTERSECTIONS: u64 = 1 << 28;

/// Splats per parallel chunk: tens of microseconds.
const SPLATS_PER_CHUNK: usize = 1024;

/// The image divided into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Grid {
    /// Tiles per row of tiles.
    pub fn columns(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Rows of tiles.
    pub fn rows(&self) -> usize {
        self.height.div_ceil(TILE)
    }

    /// The number of tiles.
    pub fn tiles(&self) -> usize {
        self.columns() * self.rows()
    }

    /// The pixel (x, y) in the upper left corner of a tile.
    pub fn origin(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns() * TILE, tile / self.columns() * TILE]
    }

    /// Width and height of the part of a tile inside the image.
    pub fn extent(&self, tile: usize) -> [usize; 2] {
        let [x, y] = self.origin(tile);
        [TILE.min(self.width - x), TILE.min(self.height - y)]
    }
}

/// The splats of every tile. A splat's *rank* is its place in depth order among those that meet the image; an *entry* is one
/// (tile, splat) pair, tile by tile and front to back; a *hit* is the same pair, rank by rank and tiles ascending.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileLists {
    /// The tiles of the image.
    pub grid: Grid,
    /// `[ranks]`: the index of the splat.
    pub order: Vec<u32>,
    /// `[N]`: the rank of a splat, `TileLists::NO_RANK` if it has none.
    pub rank_of_splat: Vec<u32>,
    /// `[entries]`: the rank of each entry.
    pub ranks: Vec<u32>,
    /// [tiles + 1]: where the entries of a tile begin.
    pub tile_starts: Vec<usize>,
    /// `[hits]`: the entry of each hit.
    pub entry_of_hit: Vec<u32>,
    /// [ranks + 1]: where the hits of a rank begin.
    pub hit_starts: Vec<usize>,
}

impl TileLists {
    /// The rank of a splat that no tile holds.
    pub(crate) const NO_RANK: u32 = u32::MAX;

    /// The ranks in a tile, front to back.
    pub fn tile(&self, tile: usize) -> &[u32] {
        &self.ranks[self.tile_starts[tile]..self.tile_starts[tile + 1]]
    }

    /// The entries of a splat, in a fixed order; empty if no tile holds it.
    pub(crate) fn entries_of_splat(&self, splat: usize) -> &[u32] {
        match self.rank_of_splat[splat] {
            Self::NO_RANK => &[],
            rank => &self.entry_of_hit[self.hit_starts[rank as usize]..self.hit_starts[rank as usize + 1]],
        }
    }
}

/// The lists of a render, where it runs.
#[derive(Debug)]
pub enum Lists {
    /// Lists in the host's memory.
    Host(TileLists),
    /// Lists in a GPU's memory.
    Gpu(Box<GpuLists>),
}

impl Lists {
    /// The lists in the host's memory. Panics if a GPU made them: such lists are never copied implicitly.
    pub fn on_host(&self) -> &TileLists {
        match self {
            Self::Host(lists) => lists,
            Self::Gpu(_) => panic!("the lists of tiles are on a GPU"),
        }
    }

    /// Splats that some tile holds; read back from a GPU.
    pub fn visible_count(&self) -> usize {
        match self {
            Self::Host(lists) => lists.order.len(),
            Self::Gpu(lists) => lists.visible.read_one(0) as usize,
        }
    }

    /// (Tile, splat) pairs; read back from a GPU.
    pub fn entry_count(&self) -> usize {
        match self {
            Self::Host(lists) => lists.ranks.len(),
            Self::Gpu(lists) => lists.entries.array().read_one(0) as usize,
        }
    }

    /// `[N]`: whether any tile holds the splat; read back from a GPU.
    pub fn visible(&self) -> Vec<bool> {
        let has_rank = |ranks: &[u32]| ranks.iter().map(|&rank| rank != TileLists::NO_RANK).collect();
        match self {
            Self::Host(lists) => has_rank(&lists.rank_of_splat),
            Self::Gpu(lists) => {
                let mut ranks = vec![0; lists.rank_of_splat.len()];
                lists.rank_of_splat.read_into(&mut ranks);
                has_rank(&ranks)
            }
        }
    }
}

/// Error: the splats cover more tiles than the lists may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyIntersections {
    /// (Tile, splat) pairs.
    pub count: u64,
}

impl fmt::Display for TooManyIntersections {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "splats cover {} tiles in total, more than {MAX_INTERSECTIONS}", self.count)?;
        write!(formatter, "; hint: the Gaussians have grown too large, lower the learning rate of their scales")
    }
}

impl std::error::Error for TooManyIntersections {}

/// The projected splats of each tile of `grid`; listed as `"binning"` in the tape's profile.
pub fn bin<T: Real>(
    tape: &mut Tape<T>,
    projected: &ProjectedVars,
    grid: Grid,
) -> Result<Arc<Lists>, TooManyIntersections> {
    let result = Arc::new(OnceLock::new());
    let inputs = [projected.means2d, projected.conics, projected.depths, projected.cutoffs];
    let capacity = tape.capacity();
    tape.apply(Binning { grid, capacity, result: result.clone() }, &inputs);
    let lists = result.get().expect("binning has run").clone()?;
    if let Lists::Gpu(on_gpu) = &*lists {
        let length = on_gpu.entries.clone();
        tape.defer(DeferredCount::Intersections { length, capacity: capacity.unwrap_or(usize::MAX) });
    }
    Ok(lists)
}

/// Computes no values; it is an operation so that the profile lists its time.
struct Binning {
    grid: Grid,
    /// The capacity of buffers on a GPU, in intersections; `None`: the host reads the count back, then allocates.
    capacity: Option<usize>,
    result: Arc<OnceLock<Result<Arc<Lists>, TooManyIntersections>>>,
}

impl Binning {
    fn publish(&self, lists: Result<Lists, TooManyIntersections>) {
        assert!(self.result.set(lists.map(Arc::new)).is_ok(), "an operation runs forward once");
    }
}

impl<T: Real> Op<T> for Binning {
    fn name(&self) -> &'static str {
        "binning"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [means2d, conics, depths, cutoffs] = exactly(inputs);
        let splats = Splats {
            means2d: means2d.as_slice().as_chunks().0,
            conics: conics.as_slice().as_chunks().0,
            depths: depths.as_slice(),
            cutoffs: cutoffs.as_slice(),
        };
        self.publish(tile_lists(&splats, self.grid).map(Lists::Host));
        Vec::new()
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![None; pass.inputs.len()]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Binning {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        let [means2d, conics, depths, cutoffs] = exactly(inputs);
        // `None`: this operation runs on the CPU, which reports the exact count.
        let lists = gpu::tile_lists(gpu, [means2d, conics, depths, cutoffs], self.grid, self.capacity)?;
        self.publish(Ok(Lists::Gpu(Box::new(lists))));
        Some(Vec::new())
    }

    fn backward_gpu(&mut self, _gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        self.backward(pass)
    }
}

/// Projected splats, as returned by [`crate::rasteriser::projection`].
struct Splats<'a, T> {
    means2d: &'a [[T; 2]],
    conics: &'a [[T; 3]],
    depths: &'a [T],
    cutoffs: &'a [T],
}

impl<T: Real> Splats<'_, T> {
    fn ellipse(&self, splat: u32) -> Ellipse<T> {
        let splat = splat as usize;
        Ellipse::new(self.means2d[splat], self.conics[splat], self.cutoffs[splat])
    }
}

fn tile_lists<T: Real>(splats: &Splats<T>, grid: Grid) -> Result<TileLists, TooManyIntersections> {
    let order = depth_order(splats);
    check_capacity(splats, &order, grid)?;
    let (order, hit_tiles, hit_starts) = hits(splats, order, grid);

    // A counting sort of the hits by tile, which keeps the order of ranks within each tile.
    let mut tile_starts = vec![0; grid.tiles() + 1];
    hit_tiles.iter().for_each(|&tile| tile_starts[tile as usize + 1] += 1);
    (0..grid.tiles()).for_each(|tile| tile_starts[tile + 1] += tile_starts[tile]);
    let mut next_entry = tile_starts.clone();
    let mut ranks = vec![0; hit_tiles.len()];
    let mut entry_of_hit = vec![0; hit_tiles.len()];
    for rank in 0..order.len() {
        for hit in hit_starts[rank]..hit_starts[rank + 1] {
            let entry = &mut next_entry[hit_tiles[hit] as usize];
            ranks[*entry] = rank as u32;
            entry_of_hit[hit] = *entry as u32;
            *entry += 1;
        }
    }
    let mut rank_of_splat = vec![TileLists::NO_RANK; splats.depths.len()];
    order.iter().enumerate().for_each(|(rank, &splat)| rank_of_splat[splat as usize] = rank as u32);
    Ok(TileLists { grid, order, rank_of_splat, ranks, tile_starts, entry_of_hit, hit_starts })
}

/// The splats that were not culled, by depth and then by index.
fn depth_order<T: Real>(splats: &Splats<T>) -> Vec<u32> {
    let count = u32::try_from(splats.depths.len()).expect("more than 2³² splats");
    let is_visible = |&splat: &u32| splats.cutoffs[splat as usize] >= T::ZERO;
    // The bits of positive floats sort as the numbers do; the index makes every key unique.
    let key =
        |splat: u32| u64::from((splats.depths[splat as usize].to_f64() as f32).to_bits()) << 32 | u64::from(splat);
    let mut keys: Vec<u64> = (0..count).filter(is_visible).map(key).collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|key| key as u32).collect()
}

/// Refuses more than [`MAX_INTERSECTIONS`], counted exactly only if neither the tiles nor the bounding boxes rule it out.
fn check_capacity<T: Real>(splats: &Splats<T>, order: &[u32], grid: Grid) -> Result<(), TooManyIntersections> {
    let total = |count_tiles: fn(&Ellipse<T>, Grid) -> u64| -> u64 {
        order.par_iter().map(|&splat| count_tiles(&splats.ellipse(splat), grid)).sum()
    };
    let is_impossible = (order.len() * grid.tiles()) as u64 <= MAX_INTERSECTIONS;
    if is_impossible || total(Ellipse::box_tiles) <= MAX_INTERSECTIONS {
        return Ok(());
    }
    let count = total(|ellipse, grid| ellipse.tile_spans(grid).map(|(_, columns)| columns.len() as u64).sum());
    if count <= MAX_INTERSECTIONS { Ok(()) } else { Err(TooManyIntersections { count }) }
}

/// The splats of `order` that meet a tile, the tiles they meet, and where those of each splat begin.
fn hits<T: Real>(splats: &Splats<T>, order: Vec<u32>, grid: Grid) -> (Vec<u32>, Vec<u32>, Vec<usize>) {
    let per_chunk = chunks::map_chunks(order.len(), SPLATS_PER_CHUNK, |range| {
        let (mut tiles, mut counts) = (Vec::new(), Vec::with_capacity(range.len()));
        for &splat in &order[range] {
            let before = tiles.len();
            for (row, columns) in splats.ellipse(splat).tile_spans(grid) {
                let first = (row * grid.columns()) as u32;
                tiles.extend(columns.map(|column| first + column as u32));
            }
            counts.push(tiles.len() - before);
        }
        (tiles, counts)
    });
    let (tiles, counts): (Vec<_>, Vec<_>) = per_chunk.into_iter().unzip();
    let (mut kept, mut starts) = (Vec::with_capacity(order.len()), vec![0]);
    for (splat, count) in order.into_iter().zip(counts.into_iter().flatten()) {
        if count > 0 {
            kept.push(splat);
            starts.push(starts[starts.len() - 1] + count);
        }
    }
    (kept, tiles.concat(), starts)
}
