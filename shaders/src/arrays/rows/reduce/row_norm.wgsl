// The norms of rows, with LANES invocations per row.
#import gpu::row_sum
#const LANES

struct Lengths {
    rows: u32,
    columns: u32,
    epsilon: f32,
}

@group(0) @binding(0) var<uniform> sizes: Lengths;
@group(0) @binding(1) var<storage, read> x: array<f32>;

// Returns ‖x‖ of the invocation's row. Every invocation of the workgroup must call it, in uniform control flow.
fn norm_of(row: u32, local: u32) -> f32 {
    var own = 0.0;
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            let value = x[row * sizes.columns + column];
            own += value * value;
        }
    }
    return sqrt(row_sum(local, own));
}
