// Sizes of a weighted mean of squared distances between rows.

struct Weighted {
    rows: u32,
    columns: u32,
}

@group(0) @binding(0) var<uniform> sizes: Weighted;

// 1 / (K·Σ w), or 0 if all weights are 0.
fn factor_of(weight_sum: f32) -> f32 {
    if (weight_sum == 0.0) {
        return 0.0;
    }
    return 1.0 / (f32(sizes.columns) * weight_sum);
}
