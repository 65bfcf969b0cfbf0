// Standardises rows to mean 0 and variance 1. LANES invocations per row.
#import gpu::flat_group
#import networks::layer_norm::row_moments
#const LANES

@group(0) @binding(2) var<storage, read_write> y: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let row = flat_group(group, groups) * (256u / LANES) + local / LANES;
    let of_row = moments(local, row);
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            let at = row * sizes.columns + column;
            y[at] = (x[at] - of_row.x) / of_row.y;
        }
    }
}
