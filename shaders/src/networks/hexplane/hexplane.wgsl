// Hexplane features of all scales (K-Planes product of six planes). One invocation per scale, point and channel.

@group(0) @binding(2) var<storage, read_write> features: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let scale = item_of(flat);
    let own = constants_of(scale);
    let index = (flat - first_group(scale)) * 256u + local;
    let point = index / own.channels;
    if (point >= own.points) {
        return;
    }
    let channel = index % own.channels;
    let r = readings_of(scale, point, channel);
    let spatial = r.xy.value * r.xz.value * r.yz.value;
    features[point * own.features + own.number * own.channels + channel] =
        spatial * (r.xt.value * r.yt.value * r.zt.value);
}
