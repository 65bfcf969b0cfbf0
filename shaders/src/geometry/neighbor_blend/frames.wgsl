// The weighted mean of the positions to which a point's nodes carry it. One invocation per point.
#import geometry::neighbor_blend::node_frame
#import gpu::elements_64

@group(0) @binding(6) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(7) var<storage, read_write> y: array<f32>;

fn run(point: u32) {
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
