// The weighted mean, from both sums. One invocation.
#import arrays::rows::weighted_mean::weighted_mean_factor

@group(0) @binding(1) var<storage, read> sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> mean: array<f32>;

@compute @workgroup_size(1)
fn main() {
    mean[0] = factor_of(sums[0]) * sums[1];
}
