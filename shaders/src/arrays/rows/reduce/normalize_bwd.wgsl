// The gradient of x / max(‖x‖, ε): for norms of at least ε, only the tangential component passes. LANES invocations per
// row.
#import arrays::rows::reduce::row_norm
#import gpu::flat_group
#import gpu::row_sum
#const LANES

@group(0) @binding(2) var<storage, read> y: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read_write> dx: array<f32>;

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
    var own = 0.0;
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            own += y[row * sizes.columns + column] * dy[row * sizes.columns + column];
        }
    }
    let product = row_sum(local, own);
    let radial = select(product, 0.0, is_short);
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            let at = row * sizes.columns + column;
            dx[at] = (dy[at] - radial * y[at]) / length;
        }
    }
}
