// Central difference convolution: the weights, with θ times the sum of the taps subtracted from the central tap. If
// BACKWARD is 1: the gradients of all taps less θ times that of the central one. One invocation per weight.
#import gpu::elements
#const BACKWARD

struct Central {
    len: u32,
    taps: u32,
    channels: u32,
    theta: f32,
}

@group(0) @binding(0) var<uniform> sizes: Central;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

fn run(at: u32) {
    if (at >= sizes.len) {
        return;
    }
    // The first and the central tap of the same output and channel.
    let first = at / (sizes.taps * sizes.channels) * sizes.taps * sizes.channels + at % sizes.channels;
    let center = first + sizes.taps / 2u * sizes.channels;
    var difference = 0.0;
    if (BACKWARD == 1u) {
        difference = weights[center];
    } else if (at == center) {
        for (var tap = 0u; tap < sizes.taps; tap++) {
            difference += weights[first + tap * sizes.channels];
        }
    }
    out[at] = weights[at] - sizes.theta * difference;
}
