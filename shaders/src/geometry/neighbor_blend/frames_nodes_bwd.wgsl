// The gradients of the nodes' positions, translations and rotations. LANES invocations per node; each takes every
// LANES-th of the points that follow the node.
#import geometry::algebra
#import geometry::neighbor_blend::node_frame
#import gpu::flat_group
#import gpu::row_sum
#const LANES

@group(0) @binding(6) var<storage, read> items: array<u32>;
@group(0) @binding(7) var<storage, read> starts: array<u32>;
@group(0) @binding(8) var<storage, read> dy: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_positions: array<f32>;
@group(0) @binding(10) var<storage, read_write> g_translations: array<f32>;
@group(0) @binding(11) var<storage, read_write> g_rotations: array<vec4<f32>>;

fn vector_sum(local: u32, value: vec3<f32>) -> vec3<f32> {
    let x = row_sum(local, value.x);
    let y = row_sum(local, value.y);
    return vec3<f32>(x, y, row_sum(local, value.z));
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let node = flat_group(group, groups) * (256u / LANES) + local / LANES;
    var pulled = vec3<f32>(0.0);
    // Σ pull·(x − p)ᵀ, the gradient of the rotation matrix.
    var outer = Rows(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
    if (node < sizes.nodes) {
        let position = position_of(node);
        for (var at = starts[node] + local % LANES; at < starts[node + 1u]; at += LANES) {
            let point = items[at] / sizes.per_point;
            let pull = weights[items[at]] * vec3<f32>(dy[3u * point], dy[3u * point + 1u], dy[3u * point + 2u]);
            let arm = point_at(point) - position;
            pulled += pull;
            outer.x += pull.x * arm;
            outer.y += pull.y * arm;
            outer.z += pull.z * arm;
        }
    }
    let total = vector_sum(local, pulled);
    let row_x = vector_sum(local, outer.x);
    let row_y = vector_sum(local, outer.y);
    let row_z = vector_sum(local, outer.z);
    if (node < sizes.nodes && local % LANES == 0u) {
        let unit = normalised(rotations[node]);
        let g_position = total - row_times(total, rotation_matrix(unit.quaternion));
        for (var axis = 0u; axis < 3u; axis++) {
            g_positions[3u * node + axis] = g_position[axis];
            g_translations[3u * node + axis] = total[axis];
        }
        let g_unit = rotation_backward(unit.quaternion, Rows(row_x, row_y, row_z));
        g_rotations[node] = normalised_backward(unit, g_unit);
    }
}
