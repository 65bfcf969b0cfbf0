// The sums of ranges of a list. One workgroup per range.
#import gpu::flat_group
#import gpu::grouped::grouped
#import gpu::row_sum
#extern fn set_total(item: u32, at: u32, value: f32)

struct Item {
    first: u32,
    end: u32,
}

@group(0) @binding(1) var<storage, read> sums: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let item = item_of(flat_group(group, groups));
    let run = constants_of(item);
    var own = 0.0;
    for (var at = run.first + local; at < run.end; at += 256u) {
        own += sums[at];
    }
    let sum = row_sum(local, own);
    if (local == 0u) {
        set_total(item, 0u, sum);
    }
}
