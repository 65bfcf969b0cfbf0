// The sum of `term(at)` over every block of 4096 terms, times a factor. One workgroup per block. The importing file
// declares its arrays from binding 2 on.
#import gpu::flat_group
#import gpu::row_sum
#extern fn term(at: u32) -> f32

struct Total {
    len: u32,
    factor: f32,
}

@group(0) @binding(0) var<uniform> total: Total;
@group(0) @binding(1) var<storage, read_write> sums: array<f32>;

const BLOCK: u32 = 4096u;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    let end = min((block + 1u) * BLOCK, total.len);
    var own = 0.0;
    for (var at = block * BLOCK + local; at < end; at += 256u) {
        own += term(at);
    }
    let sum = row_sum(local, own);
    if (local == 0u && block < arrayLength(&sums)) {
        sums[block] = total.factor * sum;
    }
}
