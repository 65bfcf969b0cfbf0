// Mean and standard deviation of a row that LANES invocations share.
#import gpu::row_sum
#const LANES

struct Norm {
    rows: u32,
    columns: u32,
}

@group(0) @binding(0) var<uniform> sizes: Norm;
@group(0) @binding(1) var<storage, read> x: array<f32>;

const EPSILON: f32 = 1e-5;

// Returns (mean, deviation) to each invocation of a row. Every invocation of the workgroup must call it, in uniform
// control flow.
fn moments(local: u32, row: u32) -> vec2<f32> {
    let first = row * sizes.columns;
    var own = 0.0;
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            own += x[first + column];
        }
    }
    let mean = row_sum(local, own) / f32(sizes.columns);
    own = 0.0;
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            let difference = x[first + column] - mean;
            own += difference * difference;
        }
    }
    return vec2<f32>(mean, sqrt(row_sum(local, own) / f32(sizes.columns) + EPSILON));
}
