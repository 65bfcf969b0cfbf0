// The gradients of the weights before normalisation, (dwₖ − Σⱼ wⱼdwⱼ) / sum, and of the points. One invocation per
// point.
#import geometry::neighbor_blend::node_weight
#import gpu::elements

@group(0) @binding(5) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(6) var<storage, read> weights: array<f32>;
@group(0) @binding(7) var<storage, read> dweights: array<f32>;
@group(0) @binding(8) var<storage, read_write> unnormalised: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_points: array<f32>;

fn run(point: u32) {
    if (point >= sizes.points) {
        return;
    }
    let first = point * sizes.per_point;
    var total = 0.0;
    var along = 0.0;
    for (var item = first; item < first + sizes.per_point; item++) {
        total += weight_of(pair_of(point, node_of_item[item]));
        along += weights[item] * dweights[item];
    }
    for (var axis = 0u; axis < sizes.axes; axis++) {
        g_points[point * sizes.axes + axis] = 0.0;
    }
    for (var item = first; item < first + sizes.per_point; item++) {
        let node = node_of_item[item];
        let pair = pair_of(point, node);
        let dweight = (dweights[item] - along) / total;
        unnormalised[item] = dweight;
        let pull = -dweight * pair.gate * pair.falloff * pair.inverse_variance;
        for (var axis = 0u; axis < sizes.axes; axis++) {
            g_points[point * sizes.axes + axis] += pull * difference(point, node, axis);
        }
    }
}
