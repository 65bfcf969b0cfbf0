// Adds the sum of all previous blocks to the exclusive prefix sums within blocks. One invocation per number.

struct Scan {
    len: u32,
}

@group(0) @binding(0) var<uniform> scan: Scan;
@group(0) @binding(1) var<storage, read> before: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

const CAP: u32 = 0x20000000u;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    if (index < scan.len) {
        sums[index] = min(sums[index] + before[index / 1024u], CAP);
    }
}
