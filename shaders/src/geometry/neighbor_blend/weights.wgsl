// The normalised weights of every point's nodes. One invocation per point.

@group(0) @binding(5) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(6) var<storage, read_write> weights: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let point = flat_group(group, groups) * 256u + local;
    if (point >= sizes.points) {
        return;
    }
    let first = point * sizes.per_point;
    var total = 0.0;
    for (var item = first; item < first + sizes.per_point; item++) {
        let weight = weight_of(pair_of(point, node_of_item[item]));
        weights[item] = weight;
        total += weight;
    }
    for (var item = first; item < first + sizes.per_point; item++) {
        weights[item] /= total;
    }
}
