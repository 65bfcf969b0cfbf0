// The gradients of the blend weights. One invocation per weight.

struct Blend {
    points: u32,
    per_point: u32,
    columns: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Blend;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_weights: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let item = flat_group(group, groups) * 256u + local;
    if (item >= sizes.points * sizes.per_point) {
        return;
    }
    let of_node = node_of_item[item] * sizes.columns;
    let of_point = item / sizes.per_point * sizes.columns;
    var sum = 0.0;
    for (var column = 0u; column < sizes.columns; column++) {
        sum += values[of_node + column] * dy[of_point + column];
    }
    g_weights[item] = sum;
}
