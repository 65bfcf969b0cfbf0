// The gradients of what every point read from the six planes, and of the positions. A workgroup has whole points, with one
// invocation per channel. FIRST is 1 for the first scale, to whose gradients of the positions the others add.

@group(0) @binding(8) var<storage, read> dy: array<f32>;
// [6, points, channels].
@group(0) @binding(9) var<storage, read_write> g_values: array<f32>;
@group(0) @binding(10) var<storage, read_write> g_positions: array<f32>;

// [3, invocation]: the derivatives along x, y and z in texels, by channel.
var<workgroup> along: array<f32, 768>;

fn write_gradient(plane: u32, point: u32, channel: u32, gradient: f32) {
    g_values[(plane * scale.points + point) * scale.channels + channel] = gradient;
}

// dy times the product of the other five values, for each of the six.
fn differentiate(point: u32, channel: u32, local: u32) {
    let r = readings_of(point, channel);
    let g = dy[point * scale.features + scale.first_feature + channel];
    // What stands before each value, with dy, and after it.
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
    write_gradient(0u, point, channel, g_xy);
    write_gradient(1u, point, channel, g_xz);
    write_gradient(2u, point, channel, g_xt);
    write_gradient(3u, point, channel, g_yz);
    write_gradient(4u, point, channel, g_yt);
    write_gradient(5u, point, channel, g_zt);
    along[local] = (g_xy * r.xy.along_a + g_xz * r.xz.along_a) + g_xt * r.xt.along_a;
    along[256u + local] = (g_xy * r.xy.along_b + g_yz * r.yz.along_a) + g_yt * r.yt.along_a;
    along[512u + local] = (g_xz * r.xz.along_b + g_yz * r.yz.along_b) + g_zt * r.zt.along_a;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let points_per_group = 256u / scale.channels;
    let first_point = flat_group(group, groups) * points_per_group;
    let own_point = first_point + local / scale.channels;
    if (local < points_per_group * scale.channels && own_point < scale.points) {
        differentiate(own_point, local % scale.channels, local);
    }
    workgroupBarrier();

    // One invocation per point and axis adds over the channels.
    let point = first_point + local / 3u;
    if (local >= 3u * points_per_group || point >= scale.points) {
        return;
    }
    let axis = local % 3u;
    var sum = 0.0;
    for (var channel = 0u; channel < scale.channels; channel++) {
        sum += along[256u * axis + local / 3u * scale.channels + channel];
    }
    let at = 3u * point + axis;
    let gradient = sum * lookup(positions[at], scale.resolution[axis]).slope;
    if (FIRST == 1u) {
        g_positions[at] = gradient;
    } else {
        g_positions[at] += gradient;
    }
}
