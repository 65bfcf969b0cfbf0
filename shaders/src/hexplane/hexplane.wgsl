// The features of one scale: one invocation per point and channel.

@group(0) @binding(8) var<storage, read_write> features: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    let point = index / scale.channels;
    if (point >= scale.points) {
        return;
    }
    let channel = index % scale.channels;
    let r = readings_of(point, channel);
    let spatial = r.xy.value * r.xz.value * r.yz.value;
    features[point * scale.features + scale.first_feature + channel] =
        spatial * (r.xt.value * r.yt.value * r.zt.value);
}
