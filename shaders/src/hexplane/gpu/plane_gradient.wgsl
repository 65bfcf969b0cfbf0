
// The gradient of every element of every plane.

@group(0) @binding(1) var<storage, read> dy: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let plane = constants_of(item);
    let at = (flat - first_group(item)) * 256u + local;
    if (at >= plane.rows * plane.row_len) {
        return;
    }
    var sum = plane.factor * dy[0] * derivative(item, at);
    if (plane.adds == 1u) {
        sum += gradient(item, at);
    }
    set_gradient(item, at, sum);
}
