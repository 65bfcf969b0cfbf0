// The gradients of rows, from those of their standardised form: dx = (dy − mean(dy) − y·mean(y·dy)) / deviation. LANES
// invocations per row.
#import gpu::flat_group
#import gpu::row_sum
#import networks::layer_norm::row_moments
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
    let deviation = moments(local, row).y;
    let first = row * sizes.columns;
    var own = vec2<f32>(0.0);
    if (row < sizes.rows) {
        for (var column = local % LANES; column < sizes.columns; column += LANES) {
            own += dy[first + column] * vec2<f32>(1.0, y[first + column]);
        }
    }
    let by_mean = row_sum(local, own.x) / f32(sizes.columns);
    let by_deviation = row_sum(local, own.y) / f32(sizes.columns);
    if (row < sizes.rows) {
        for (var at = first + local % LANES; at < first + sizes.columns; at += LANES) {
            dx[at] = (dy[at] - by_mean - y[at] * by_deviation) / deviation;
        }
    }
}
