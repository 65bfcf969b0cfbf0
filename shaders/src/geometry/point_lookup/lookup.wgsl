// Samples an image at every position. One invocation per position.
#import geometry::point_lookup::texel_window
#import gpu::elements_64

@group(0) @binding(3) var<storage, read_write> values: array<f32>;

fn run(at: u32) {
    if (at >= sizes.count) {
        return;
    }
    var window = window_of(pixels[at]);
    for (var channel = 0u; channel < sizes.channels; channel++) {
        var sum = 0.0;
        for (var corner = 0u; corner < 4u; corner++) {
            // A texel with weight 0 may be infinite.
            if (window.valid && window.weights[corner] != 0.0) {
                sum += window.weights[corner] * image[window.texels[corner] * sizes.channels + channel];
            }
        }
        values[at * sizes.channels + channel] = sum;
    }
}
