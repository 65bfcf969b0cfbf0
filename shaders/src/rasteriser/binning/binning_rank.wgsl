// From the depth order of the splats: the rank of each splat, the number of visible splats (those that intersect a
// tile), and the input of the prefix sum: the number of tiles of each rank, then 0.
#import arrays::sort::scan
#import gpu::nowhere

@group(0) @binding(3) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> rank_of_splat: array<u32>;
@group(0) @binding(7) var<storage, read_write> visible: array<u32>;

fn number(rank: u32) -> u32 {
    let is_rank = rank + 1u < scan.len;
    let is_visible = is_rank && sorted_keys[rank] != NOWHERE;
    // The first rank that is not visible is the number of visible splats.
    if (!is_visible && (rank == 0u || sorted_keys[max(rank, 1u) - 1u] != NOWHERE)) {
        visible[0] = rank;
    }
    if (!is_rank) {
        return 0u;
    }
    let splat = order[rank];
    rank_of_splat[splat] = select(NOWHERE, rank, is_visible);
    return counts[splat];
}
