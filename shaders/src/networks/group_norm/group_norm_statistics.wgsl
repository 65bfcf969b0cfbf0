// The mean of the terms of every group of PER_GROUP channels, or 1/√(mean + ε) if SQUARES is 1. One workgroup per
// group.
#import gpu::flat_group
#import gpu::row_sum
#const PER_GROUP, SQUARES

struct Statistics {
    pixels: u32,
    blocks: u32,
    groups: u32,
}

@group(0) @binding(0) var<uniform> sizes: Statistics;
@group(0) @binding(1) var<storage, read> block_sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> statistics: array<f32>;

const EPSILON: f32 = 1e-5;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups);
    var own = 0.0;
    if (index < sizes.groups) {
        for (var at = local; at < sizes.blocks * PER_GROUP; at += 256u) {
            let row = 2u * (at / PER_GROUP) * sizes.groups * PER_GROUP;
            own += block_sums[row + index * PER_GROUP + at % PER_GROUP];
        }
    }
    let mean = row_sum(local, own) / f32(sizes.pixels * PER_GROUP);
    if (index < sizes.groups && local == 0u) {
        if (SQUARES == 0u) {
            statistics[index] = mean;
        } else {
            statistics[index] = 1.0 / sqrt(mean + EPSILON);
        }
    }
}
