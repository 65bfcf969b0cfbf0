// The weighted sum of the values of a point's nodes. One invocation per value.
#import gpu::elements

struct Blend {
    points: u32,
    per_point: u32,
    columns: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Blend;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> values: array<f32>;
@group(0) @binding(3) var<storage, read> node_of_item: array<u32>;
@group(0) @binding(4) var<storage, read_write> y: array<f32>;

fn run(at: u32) {
    if (at >= sizes.points * sizes.columns) {
        return;
    }
    let first = at / sizes.columns * sizes.per_point;
    var sum = 0.0;
    for (var item = first; item < first + sizes.per_point; item++) {
        sum += weights[item] * values[node_of_item[item] * sizes.columns + at % sizes.columns];
    }
    y[at] = sum;
}
