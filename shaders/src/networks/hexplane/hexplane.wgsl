// Hexplane features of all scales (K-Planes product of six planes). One invocation per scale, point and channel.
#import gpu::grouped::elements
#import gpu::grouped::grouped
#import networks::hexplane::plane_samples

@group(0) @binding(2) var<storage, read_write> features: array<f32>;

fn run(scale: u32, index: u32) {
    let own = constants_of(scale);
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
