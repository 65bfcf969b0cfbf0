// The gradients of the weighted mean. One invocation per element of `a`; the first of a row also computes that of the
// weight.
#import arrays::rows::weighted_mean::weighted_mean_factor
#import gpu::elements

@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> mean: array<f32>;
@group(0) @binding(5) var<storage, read> dy: array<f32>;
@group(0) @binding(6) var<storage, read> sums: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_a: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_b: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_weights: array<f32>;

fn run(index: u32) {
    if (index >= sizes.rows * sizes.columns) {
        return;
    }
    let row = index / sizes.columns;
    let factor = factor_of(sums[0]) * dy[0];
    let gradient = 2.0 * factor * weights[row] * (a[index] - b[index]);
    g_a[index] = gradient;
    g_b[index] = -gradient;
    if (index % sizes.columns == 0u) {
        var squares = 0.0;
        for (var at = index; at < index + sizes.columns; at++) {
            squares += (a[at] - b[at]) * (a[at] - b[at]);
        }
        g_weights[row] = factor * (squares - f32(sizes.columns) * mean[0]);
    }
}
