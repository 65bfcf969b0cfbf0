// The terms |render − target| of the L1 loss.
#import arrays::sums::total

@group(0) @binding(2) var<storage, read> render: array<f32>;
@group(0) @binding(3) var<storage, read> image: array<f32>;

fn term(at: u32) -> f32 {
    return abs(render[at] - image[at]);
}
