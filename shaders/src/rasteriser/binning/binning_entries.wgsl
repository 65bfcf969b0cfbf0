// From the hits sorted by tile: the rank of every entry, the entry of every hit, and the first entry of every tile. One
// invocation per entry.
#import gpu::elements
#import gpu::nowhere

struct Entries {
    tiles: u32,
}

@group(0) @binding(0) var<uniform> sizes: Entries;
// Its first element is the number of entries.
@group(0) @binding(1) var<storage, read> length: array<u32>;
@group(0) @binding(2) var<storage, read> sorted_tiles: array<u32>;
@group(0) @binding(3) var<storage, read> hit_of_entry: array<u32>;
@group(0) @binding(4) var<storage, read> hit_ranks: array<u32>;
@group(0) @binding(5) var<storage, read_write> ranks: array<u32>;
@group(0) @binding(6) var<storage, read_write> tile_starts: array<u32>;
@group(0) @binding(7) var<storage, read_write> entry_of_hit: array<u32>;

fn run(entry: u32) {
    let count = length[0];
    if (entry >= count && entry > 0u) {
        return;
    }
    // The first entry of a tile writes the start of its tile and of the empty tiles before it. The last entry writes
    // the starts after its tile. Without entries, every start is 0.
    var tile = 0u;
    if (count > 0u) {
        let hit = hit_of_entry[entry];
        tile = min(sorted_tiles[entry], sizes.tiles);
        ranks[entry] = hit_ranks[hit];
        entry_of_hit[hit] = select(NOWHERE, entry, tile < sizes.tiles);
    }
    var first_tile = 0u;
    if (entry > 0u) {
        first_tile = min(sorted_tiles[entry - 1u], sizes.tiles) + 1u;
    }
    for (var start = first_tile; start <= tile; start++) {
        tile_starts[start] = entry;
    }
    if (entry + 1u >= count) {
        for (var start = tile + 1u; start <= sizes.tiles; start++) {
            tile_starts[start] = count;
        }
    }
}
