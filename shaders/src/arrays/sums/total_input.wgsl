// Block sums of the elements of an array.
#import arrays::sums::total

@group(0) @binding(2) var<storage, read> x: array<f32>;

fn term(at: u32) -> f32 {
    return x[at];
}
