// The gradients of waves and times. LANES invocations per row; each takes every LANES-th value of a wave.
#import gpu::flat_group
#import gpu::row_sum
#import gpu::sine
#import networks::temporal_harmonics::wave_phase
#const LANES

@group(0) @binding(1) var<storage, read> waves: array<f32>;
@group(0) @binding(2) var<storage, read> times: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_waves: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_times: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let row = flat_group(group, groups) * (256u / LANES) + local / LANES;
    var g_time = 0.0;
    if (row < sizes.rows) {
        let offset = sizes.time - times[row];
        for (var wave = 0u; wave < sizes.waves; wave++) {
            let circle = sine_and_cosine(phase_of(wave, offset));
            let weight = circle.y;
            let slope = TAU * f32(wave + 1u) * circle.x;
            let first = (row * sizes.waves + wave) * sizes.stored;
            for (var at = local % LANES; at < sizes.stored; at += LANES) {
                var g = 0.0;
                if (at < sizes.used) {
                    g = dy[row * sizes.used + at];
                }
                g_waves[first + at] = weight * g;
                g_time += slope * waves[first + at] * g;
            }
        }
    }
    let sum = row_sum(local, g_time);
    if (row < sizes.rows && local % LANES == 0u) {
        g_times[row] = sum;
    }
}
