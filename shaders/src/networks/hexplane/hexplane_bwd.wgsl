// The gradients of the values that every point sampled from the six planes of every scale, and of the positions. A
// workgroup has whole points, with one invocation per channel, or, of a single point, one per 256th channel. If ADDS is
// 1, the gradients of the positions are added to the current values.
#import gpu::flat_group
#import gpu::grouped::grouped
#import networks::hexplane::field
#import networks::hexplane::plane_samples
#const ADDS, ITEMS

@group(0) @binding(2) var<storage, read> dy: array<f32>;
// [6·scales, points, channels].
@group(0) @binding(3) var<storage, read_write> g_values: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_positions: array<f32>;

// [3, invocation]: the derivatives along x, y and z of the invocation's channels.
var<workgroup> along: array<f32, 768>;

fn write_gradient(scale: u32, plane: u32, point: u32, channel: u32, gradient: f32) {
    g_values[((6u * scale + plane) * points() + point) * channels() + channel] = gradient;
}

// Writes, for each of the six values, dy times the product of the other five. Returns the derivatives along x, y and z.
fn differentiate(scale: u32, point: u32, channel: u32) -> vec3<f32> {
    let r = readings_of(scale, point, channel);
    let own = constants_of(scale);
    let g = dy[point * own.features + own.number * own.channels + channel];
    // The products of the factors before each value, with dy, and after it.
    let before_xz = g * r.xy.value;
    let before_yz = before_xz * r.xz.value;
    let before_xt = before_yz * r.yz.value;
    let before_yt = before_xt * r.xt.value;
    let after_yt = r.zt.value;
    let after_xt = after_yt * r.yt.value;
    let after_yz = after_xt * r.xt.value;
    let after_xz = after_yz * r.yz.value;
    let g_xy = g * (after_xz * r.xz.value);
    let g_xz = before_xz * after_xz;
    let g_yz = before_yz * after_yz;
    let g_xt = before_xt * after_xt;
    let g_yt = before_yt * after_yt;
    let g_zt = before_yt * r.yt.value;
    write_gradient(scale, 0u, point, channel, g_xy);
    write_gradient(scale, 1u, point, channel, g_xz);
    write_gradient(scale, 2u, point, channel, g_xt);
    write_gradient(scale, 3u, point, channel, g_yz);
    write_gradient(scale, 4u, point, channel, g_yt);
    write_gradient(scale, 5u, point, channel, g_zt);
    let in_texels = vec3<f32>(
        (g_xy * r.xy.along_a + g_xz * r.xz.along_a) + g_xt * r.xt.along_a,
        (g_xy * r.xy.along_b + g_yz * r.yz.along_a) + g_yt * r.yt.along_a,
        (g_xz * r.xz.along_b + g_yz * r.yz.along_b) + g_zt * r.zt.along_a,
    );
    return in_texels * vec3<f32>(r.x.slope, r.y.slope, r.z.slope);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let per_point = min(channels(), 256u);
    let points_per_group = 256u / per_point;
    let first_point = flat_group(group, groups) * points_per_group;
    let own_point = first_point + local / per_point;
    if (local < points_per_group * per_point && own_point < points()) {
        var derivatives = vec3<f32>();
        for (var channel = local % per_point; channel < channels(); channel += per_point) {
            for (var scale = 0u; scale < ITEMS; scale++) {
                derivatives += differentiate(scale, own_point, channel);
            }
        }
        along[local] = derivatives.x;
        along[256u + local] = derivatives.y;
        along[512u + local] = derivatives.z;
    }
    workgroupBarrier();

    // One invocation per point and axis sums over the channels; with one or two channels, each takes several points.
    for (var own = local; own < 3u * points_per_group; own += 256u) {
        let point = first_point + own / 3u;
        if (point < points()) {
            let axis = own % 3u;
            let at = 3u * point + axis;
            var sum = 0.0;
            for (var channel = 0u; channel < per_point; channel++) {
                sum += along[256u * axis + own / 3u * per_point + channel];
            }
            if (ADDS == 1u) {
                sum += g_positions[at];
            }
            g_positions[at] = sum;
        }
    }
}
