// Sums of |render − target| over blocks of 4096 elements: one workgroup per block.

@group(0) @binding(3) var<storage, read_write> sums: array<f32>;

const BLOCK: u32 = 4096u;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    let end = min((block + 1u) * BLOCK, l1.len);
    var own = 0.0;
    for (var at = block * BLOCK + local; at < end; at += 256u) {
        own += abs(render[at] - image[at]);
    }
    let sum = row_sum(local, own);
    if (local == 0u && block < arrayLength(&sums)) {
        sums[block] = l1.factor * sum;
    }
}
