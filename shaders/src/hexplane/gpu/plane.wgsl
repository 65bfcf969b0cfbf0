// A plane whose elements enter a mean.

struct Plane {
    rows: u32,
    row_len: u32,
    // Terms of the mean, and 1 over their number (0 where there are none).
    terms: u32,
    factor: f32,
    // Where this plane's sums begin.
    first_sum: u32,
}

@group(0) @binding(0) var<uniform> plane: Plane;
@group(0) @binding(1) var<storage, read> values: array<f32>;

