// Whether each splat is visible with its centre in a pixel of the mask. One invocation per splat.
#import gpu::elements
#import gpu::nowhere

struct Mask {
    // Number of splats.
    count: u32,
    width: u32,
    height: u32,
}

@group(0) @binding(0) var<uniform> mask: Mask;
@group(0) @binding(1) var<storage, read> means_px: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> rank_of_splat: array<u32>;
// One bit per pixel, 32 to a word.
@group(0) @binding(3) var<storage, read> bits: array<u32>;
@group(0) @binding(4) var<storage, read_write> covered: array<f32>;

fn is_covered(splat: u32) -> bool {
    let mean = means_px[splat];
    let is_within = all(mean >= vec2<f32>(0.0)) && all(mean < vec2<f32>(vec2<u32>(mask.width, mask.height)));
    if (rank_of_splat[splat] == NOWHERE || !is_within) {
        return false;
    }
    let pixel = vec2<u32>(mean);
    let at = pixel.y * mask.width + pixel.x;
    return ((bits[at / 32u] >> (at % 32u)) & 1u) == 1u;
}

fn run(splat: u32) {
    if (splat < mask.count) {
        covered[splat] = f32(is_covered(splat));
    }
}
