// The gradients of the values, from those of the shares of the two bins that each value lies between. One invocation
// per value.
#import gpu::elements
#import losses::histogram::histogram_bins

@group(0) @binding(2) var<storage, read> g_shares: array<f32>;
@group(0) @binding(3) var<storage, read_write> g_x: array<f32>;

fn run(at: u32) {
    if (at >= sizes.len) {
        return;
    }
    let place = place_of(x[at]);
    var gradient = 0.0;
    if (place.inside) {
        gradient = (g_shares[place.lower + 1u] - g_shares[place.lower]) * sizes.share / sizes.width;
    }
    g_x[at] = gradient;
}
