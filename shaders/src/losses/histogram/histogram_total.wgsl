// Sums the shares of all blocks. One workgroup per bin.
#import gpu::flat_group
#import gpu::row_sum

struct Total {
    blocks: u32,
    bins: u32,
}

@group(0) @binding(0) var<uniform> sizes: Total;
@group(0) @binding(1) var<storage, read> block_shares: array<f32>;
@group(0) @binding(2) var<storage, read_write> shares: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let bin = flat_group(group, groups);
    var own = 0.0;
    if (bin < sizes.bins) {
        for (var block = local; block < sizes.blocks; block += 256u) {
            own += block_shares[block * sizes.bins + bin];
        }
    }
    let sum = row_sum(local, own);
    if (bin < sizes.bins && local == 0u) {
        shares[bin] = sum;
    }
}
