// y = a + b for every pair of tensors. One invocation per element.

struct Item {
    len: u32,
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let at = (flat - first_group(item)) * 256u + local;
    if (at < constants_of(item).len) {
        set_y(item, at, a(item, at) + b(item, at));
    }
}
