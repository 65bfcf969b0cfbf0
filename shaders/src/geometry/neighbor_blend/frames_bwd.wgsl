// The gradients of weights and points. One invocation per point.
#import geometry::algebra
#import geometry::neighbor_blend::node_frame
#import gpu::elements_64

@group(0) @binding(6) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(7) var<storage, read> dy: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_weights: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_points: array<f32>;

fn run(point: u32) {
    if (point >= sizes.points) {
        return;
    }
    let x = point_at(point);
    let g = vec3<f32>(dy[3u * point], dy[3u * point + 1u], dy[3u * point + 2u]);
    var g_point = vec3<f32>(0.0);
    for (var rank = 0u; rank < sizes.per_point; rank++) {
        let item = point * sizes.per_point + rank;
        let node = node_of_item[item];
        let rotation = rotation_of(node);
        g_weights[item] = dot(carried(rotation, node, x), g);
        g_point += weights[item] * row_times(g, rotation);
    }
    for (var axis = 0u; axis < 3u; axis++) {
        g_points[3u * point + axis] = g_point[axis];
    }
}
