// x / max(‖x‖, ε) of every row. LANES invocations per row.
#import arrays::rows::reduce::row_norm
#import gpu::flat_group
#const LANES

@group(0) @binding(2) var<storage, read_write> y: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let row = flat_group(group, groups) * (256u / LANES) + local / LANES;
    let norm = norm_of(row, local);
    let is_short = norm < sizes.epsilon;
    let length = select(norm, sizes.epsilon, is_short);
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            let at = row * sizes.columns + column;
            y[at] = x[at] / length;
        }
    }
}
