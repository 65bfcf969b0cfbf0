// x·scale + offset per column, or dy·scale if BACKWARD is 1. One invocation per value.
#import gpu::elements
#const BACKWARD

struct Affine {
    len: u32,
    columns: u32,
}

@group(0) @binding(0) var<uniform> sizes: Affine;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> scale: array<f32>;
@group(0) @binding(3) var<storage, read> offset: array<f32>;
@group(0) @binding(4) var<storage, read_write> y: array<f32>;

fn run(at: u32) {
    if (at >= sizes.len) {
        return;
    }
    let column = at % sizes.columns;
    var value = x[at] * scale[column];
    if (BACKWARD == 0u) {
        value += offset[column];
    }
    y[at] = value;
}
