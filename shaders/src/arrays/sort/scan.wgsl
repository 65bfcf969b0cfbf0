// Exclusive prefix sums of `number(index)` within blocks of 1024, and the sum of each block. Sums saturate at CAP, so
// that they stay monotonic instead of overflowing. The importing file declares its arrays from binding 3 on. One
// workgroup per block.
#import gpu::flat_group
#extern fn number(index: u32) -> u32

struct Scan {
    len: u32,
}

@group(0) @binding(0) var<uniform> scan: Scan;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;

const CAP: u32 = 0x20000000u;
const GROUP: u32 = 256u;
const ITEMS: u32 = 4u;

var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    let first = (block * GROUP + local) * ITEMS;
    var values: array<u32, 4>;
    var own = 0u;
    for (var item = 0u; item < ITEMS; item++) {
        if (first + item < scan.len) {
            values[item] = min(number(first + item), CAP);
        }
        own = min(own + values[item], CAP);
    }

    // Inclusive prefix sums over the invocations, by doubling distances.
    partial[local] = own;
    workgroupBarrier();
    for (var distance = 1u; distance < GROUP; distance *= 2u) {
        var left = 0u;
        if (local >= distance) {
            left = partial[local - distance];
        }
        workgroupBarrier();
        partial[local] = min(partial[local] + left, CAP);
        workgroupBarrier();
    }

    var running = 0u;
    if (local > 0u) {
        running = partial[local - 1u];
    }
    for (var item = 0u; item < ITEMS; item++) {
        if (first + item < scan.len) {
            sums[first + item] = running;
        }
        running = min(running + values[item], CAP);
    }
    if (local == GROUP - 1u && block * GROUP * ITEMS < scan.len) {
        block_sums[block] = running;
    }
}
