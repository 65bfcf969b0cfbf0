// Partial sums of a mean over a plane. One workgroup per 4096 terms.
#import gpu::flat_group
#import gpu::grouped::grouped
#import gpu::row_sum
#import networks::hexplane::plane_means::second_difference
#extern fn values(item: u32, at: u32) -> f32

struct Item {
    row_len: u32,
    // Terms of the mean, and 1 over their number (0 if there are none).
    terms: u32,
    factor: f32,
    // Index of this plane's first sum.
    first_sum: u32,
    // 0: squared second differences. 1: distances to one.
    mean: u32,
}

@group(0) @binding(1) var<storage, read_write> sums: array<f32>;

const BLOCK: u32 = 4096u;

fn term(item: u32, at: u32, mean: u32, row_len: u32) -> f32 {
    if (mean == 1u) {
        return abs(1.0 - values(item, at));
    }
    let difference = second_difference(item, at, row_len);
    return difference * difference;
}

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
        own += term(item, at, plane.mean, plane.row_len);
    }
    let sum = row_sum(local, own);
    if (local == 0u && block * BLOCK < plane.terms) {
        sums[plane.first_sum + block] = plane.factor * sum;
    }
}
