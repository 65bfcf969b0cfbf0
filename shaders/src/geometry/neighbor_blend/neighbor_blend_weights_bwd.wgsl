// The gradients of the blend weights. One invocation per weight.
#import gpu::elements

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

fn run(item: u32) {
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
