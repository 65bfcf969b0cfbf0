// The terms of the gradients of scale and offset: dy·x and dy.
#import gpu::column_sums

@group(0) @binding(2) var<storage, read> x: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;

fn terms(row: u32, column: u32) -> vec2<f32> {
    let at = row * sums.columns + column;
    return dy[at] * vec2<f32>(x[at], 1.0);
}
