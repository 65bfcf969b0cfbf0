// Window attention: the weighted mean of the values. One invocation per query and head.

@group(0) @binding(4) var<storage, read_write> y: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 64u + local;
    if (index >= sizes.rows * sizes.queries * sizes.heads) {
        return;
    }
    let head = index % sizes.heads;
    let token = index / sizes.heads % sizes.queries;
    let row = index / sizes.heads / sizes.queries;
    hold_for(index, sizes.rows * sizes.queries * sizes.heads);
    look(row, token, head);
    let out = looking_at(row, token, head);
    for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
        var sum = 0.0;
        for (var at = 0u; at < WINDOW; at++) {
            sum += weight_at(at) * values[seen_at(row, at, head) + channel];
        }
        y[out + channel] = sum;
    }
}
