// The gradients of the image. One invocation per value, which sums the corners at its texel in order.
#import gpu::elements

struct Corners {
    // Values of the image.
    len: u32,
    channels: u32,
}

@group(0) @binding(0) var<uniform> sizes: Corners;
// The corners sorted by texel, and the index of the first corner of every texel.
@group(0) @binding(1) var<storage, read> corners: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> g_values: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_image: array<f32>;

fn run(index: u32) {
    if (index >= sizes.len) {
        return;
    }
    let texel = index / sizes.channels;
    var sum = 0.0;
    for (var at = starts[texel]; at < starts[texel + 1u]; at++) {
        let corner = corners[at];
        sum += weights[corner] * g_values[corner / 4u * sizes.channels + index % sizes.channels];
    }
    g_image[index] = sum;
}
