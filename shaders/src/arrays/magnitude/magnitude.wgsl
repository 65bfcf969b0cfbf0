// The largest magnitude of every item's values. One invocation per VALUES values.
#import gpu::flat_group
#import gpu::grouped::grouped
#const VALUES
#extern fn values(item: u32, at: u32) -> u32

struct Item { count: u32, slot: u32 }

@group(0) @binding(1) var<storage, read_write> largest: array<atomic<u32>>;

var<workgroup> parts: array<u32, 256>;

// Magnitudes are compared as integers: without the sign bit, floats order as their bits do, with NaN last. An integer
// maximum does not depend on the order.
@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let constants = constants_of(item);
    let first = (flat - first_group(item)) * 256u * VALUES + local;
    var mine = 0u;
    for (var at = 0u; at < VALUES; at++) {
        let i = first + 256u * at;
        if (i < constants.count) {
            mine = max(mine, values(item, i) & 0x7fffffffu);
        }
    }
    parts[local] = mine;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (local < half) {
            parts[local] = max(parts[local], parts[local + half]);
        }
    }
    if (local == 0u) {
        atomicMax(&largest[constants.slot], parts[0]);
    }
}
