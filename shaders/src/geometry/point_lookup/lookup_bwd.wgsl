// The gradients of positions. One invocation per position. It also writes the texels and weights of the position's four
// corners, from which `lookup_image_bwd` computes the gradients of the image. A corner that does not contribute has the
// number of texels as its texel.
#import geometry::point_lookup::texel_window
#import gpu::elements_64

@group(0) @binding(3) var<storage, read> g_values: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_pixels: array<vec2<f32>>;
// [positions, 4].
@group(0) @binding(5) var<storage, read_write> texels: array<u32>;
@group(0) @binding(6) var<storage, read_write> weights: array<f32>;

fn run(at: u32) {
    if (at >= sizes.count) {
        return;
    }
    var window = window_of(pixels[at]);
    var gradient = vec2<f32>(0.0);
    for (var corner = 0u; corner < 4u; corner++) {
        let slope = vec2<f32>(window.slopes_x[corner], window.slopes_y[corner]);
        if (window.valid && any(slope != vec2<f32>(0.0))) {
            var along = 0.0;
            for (var channel = 0u; channel < sizes.channels; channel++) {
                let texel = image[window.texels[corner] * sizes.channels + channel];
                along += texel * g_values[at * sizes.channels + channel];
            }
            gradient += slope * along;
        }
        let contributes = window.valid && window.weights[corner] != 0.0;
        texels[4u * at + corner] = select(sizes.width * sizes.height, window.texels[corner], contributes);
        weights[4u * at + corner] = window.weights[corner];
    }
    g_pixels[at] = gradient;
}
