// How many keys of each block have each digit: [digit, block].

struct Sort {
    len: u32,
    blocks: u32,
    // Where the digit of four bits lies in the key.
    shift: u32,
}

@group(0) @binding(0) var<uniform> sort: Sort;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

const GROUP: u32 = 128u;
const ITEMS: u32 = 8u;
const DIGITS: u32 = 16u;

var<workgroup> histogram: array<atomic<u32>, 16>;

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < DIGITS) {
        atomicStore(&histogram[local], 0u);
    }
    workgroupBarrier();
    let block = flat_group(group, groups);
    for (var item = 0u; item < ITEMS; item++) {
        let index = (block * ITEMS + item) * GROUP + local;
        if (index < sort.len) {
            // Whole numbers: the order of additions does not matter.
            atomicAdd(&histogram[(keys[index] >> sort.shift) & 15u], 1u);
        }
    }
    workgroupBarrier();
    if (local < DIGITS && block < sort.blocks) {
        counts[local * sort.blocks + block] = atomicLoad(&histogram[local]);
    }
}
