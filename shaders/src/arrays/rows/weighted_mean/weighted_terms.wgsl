// Σ w and Σ w‖a − b‖² over the 256 rows of every workgroup. One invocation per row.
#import arrays::rows::weighted_mean::weighted_mean_factor
#import gpu::flat_group
#import gpu::row_sum

@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    let row = block * 256u + local;
    var weight = 0.0;
    var squares = 0.0;
    if (row < sizes.rows) {
        weight = weights[row];
        for (var at = row * sizes.columns; at < (row + 1u) * sizes.columns; at++) {
            squares += (a[at] - b[at]) * (a[at] - b[at]);
        }
    }
    let weight_sum = row_sum(local, weight);
    let square_sum = row_sum(local, weight * squares);
    if (local == 0u && block * 256u < sizes.rows) {
        sums[2u * block] = weight_sum;
        sums[2u * block + 1u] = square_sum;
    }
}
