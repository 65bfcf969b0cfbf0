// Counts the keys of each block by the digit of the first pass, and sets the counts of the other passes to zero. One
// workgroup per block.
#import arrays::sort::sort_digits
#import gpu::flat_group

@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

var<workgroup> histogram: array<atomic<u32>, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    atomicStore(&histogram[local], 0u);
    workgroupBarrier();
    let block = flat_group(group, groups);
    for (var item = 0u; item < ITEMS; item++) {
        let index = block * BLOCK + item * GROUP + local;
        if (index < key_count()) {
            // Integer additions do not depend on the order.
            atomicAdd(&histogram[digit_of(keys[index], 0u)], 1u);
        }
    }
    workgroupBarrier();
    if (block < sort.blocks) {
        counts[count_at(0u, local, block)] = atomicLoad(&histogram[local]);
        for (var later = 1u; later < sort.passes; later++) {
            counts[count_at(later, local, block)] = 0u;
        }
    }
}
