// The hits of every rank: (tile, rank) pairs with ascending tiles. If this pass finds fewer tiles than were counted,
// the remaining hits belong to no tile. Hits above the count or the capacity are not written. One invocation per rank.
#import gpu::elements
#import gpu::length_write
#import rasteriser::binning::tile_spans

@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read> hit_starts: array<u32>;
@group(0) @binding(6) var<storage, read_write> hit_tiles: array<u32>;
@group(0) @binding(7) var<storage, read_write> hit_ranks: array<u32>;
@group(0) @binding(8) var<storage, read_write> length: array<u32>;

fn run(rank: u32) {
    if (rank == 0u) {
        write_length(hit_starts[grid.count], grid.capacity);
    }
    if (rank >= grid.count) {
        return;
    }
    var hit = hit_starts[rank];
    let end = min(hit_starts[rank + 1u], grid.capacity);
    if (hit >= end) {
        return;
    }
    let ellipse = ellipse_of(order[rank]);
    let rows = rows_of(ellipse);
    for (var row = rows.first; row < rows.end; row++) {
        let columns = columns_of(ellipse, row);
        for (var column = columns.first; column < columns.end && hit < end; column++) {
            hit_tiles[hit] = row * grid.columns + column;
            hit_ranks[hit] = rank;
            hit++;
        }
    }
    for (; hit < end; hit++) {
        hit_tiles[hit] = grid.tiles;
        hit_ranks[hit] = rank;
    }
}
