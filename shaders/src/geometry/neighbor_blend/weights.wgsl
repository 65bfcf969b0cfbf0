// The normalised weights of every point's nodes. One invocation per point.
#import geometry::neighbor_blend::node_weight
#import gpu::elements

@group(0) @binding(5) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(6) var<storage, read_write> weights: array<f32>;

fn run(point: u32) {
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
