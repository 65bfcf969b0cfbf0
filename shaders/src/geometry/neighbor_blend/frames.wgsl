// The weighted mean of the positions to which a point's nodes carry it. One invocation per point.

@group(0) @binding(6) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(7) var<storage, read_write> y: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let point = flat_group(group, groups) * 64u + local;
    if (point >= sizes.points) {
        return;
    }
    let x = point_at(point);
    var sum = vec3<f32>(0.0);
    for (var rank = 0u; rank < sizes.per_point; rank++) {
        let item = point * sizes.per_point + rank;
        let node = node_of_item[item];
        sum += weights[item] * carried(rotation_of(node), node, x);
    }
    for (var axis = 0u; axis < 3u; axis++) {
        y[3u * point + axis] = sum[axis];
    }
}
