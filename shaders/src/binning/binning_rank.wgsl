// From the order of the splats: the rank of each, how many tiles each rank meets (and 0 after the last), and the number of
// splats that meet any.

struct Ranks {
    count: u32,
}

@group(0) @binding(0) var<uniform> sizes: Ranks;
@group(0) @binding(1) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> rank_of_splat: array<u32>;
@group(0) @binding(5) var<storage, read_write> counts_of_ranks: array<u32>;
@group(0) @binding(6) var<storage, read_write> visible: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = flat_group(group, groups) * 256u + local;
    if (rank > sizes.count) {
        return;
    }
    // The one rank after the last that is visible says how many there are.
    let is_visible = rank < sizes.count && sorted_keys[min(rank, sizes.count - 1u)] != NOWHERE;
    let after_visible = rank == 0u || sorted_keys[max(rank, 1u) - 1u] != NOWHERE;
    if (!is_visible && after_visible) {
        visible[0] = rank;
    }
    counts_of_ranks[rank] = 0u;
    if (rank < sizes.count) {
        let splat = order[rank];
        rank_of_splat[splat] = select(NOWHERE, rank, is_visible);
        counts_of_ranks[rank] = counts[splat];
    }
}
