// The weight with which a point follows a node: the same definitions as on the CPU. GATED is 1 if nodes have gates.
#import geometry::algebra
#const GATED

struct Weights {
    points: u32,
    per_point: u32,
    axes: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Weights;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> nodes: array<f32>;
@group(0) @binding(3) var<storage, read> log_radii: array<f32>;
@group(0) @binding(4) var<storage, read> gates: array<f32>;

// Added to every weight before normalisation.
const FLOOR: f32 = 1e-7;

struct Pair {
    squared_distance: f32,
    // 1 / r²
    inverse_variance: f32,
    // e^(−d² / 2r²)
    falloff: f32,
    // σ(g)
    gate: f32,
}

// xₙ − pₖ along one axis.
fn difference(point: u32, node: u32, axis: u32) -> f32 {
    return points[point * sizes.axes + axis] - nodes[node * sizes.axes + axis];
}

fn pair_of(point: u32, node: u32) -> Pair {
    var squared_distance = 0.0;
    for (var axis = 0u; axis < sizes.axes; axis++) {
        let d = difference(point, node, axis);
        squared_distance += d * d;
    }
    let inverse_variance = exp(-2.0 * log_radii[node]);
    var gate = 1.0;
    if (GATED == 1u) {
        gate = sigmoid(gates[node]);
    }
    return Pair(squared_distance, inverse_variance, exp(-0.5 * squared_distance * inverse_variance), gate);
}

// The weight before normalisation.
fn weight_of(pair: Pair) -> f32 {
    return pair.falloff * pair.gate + FLOOR;
}
