
// The part of a plane's mean that every workgroup has, of 4096 terms.

@group(0) @binding(1) var<storage, read_write> sums: array<f32>;

const BLOCK: u32 = 4096u;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let plane = constants_of(item);
    let block = flat - first_group(item);
    let end = min((block + 1u) * BLOCK, plane.terms);
    var own = 0.0;
    for (var at = block * BLOCK + local; at < end; at += 256u) {
        own += term(item, at);
    }
    let sum = row_sum(local, own);
    if (local == 0u && block * BLOCK < plane.terms) {
        sums[plane.first_sum + block] = plane.factor * sum;
    }
}
