// 1 for positions within the image that sample finite texels only, otherwise 0. One invocation per position.
#import geometry::point_lookup::texel_window
#import gpu::elements_64

@group(0) @binding(3) var<storage, read_write> valid: array<f32>;

fn run(at: u32) {
    if (at < sizes.count) {
        valid[at] = f32(window_of(pixels[at]).valid);
    }
}
