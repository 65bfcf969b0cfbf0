// The terms of the statistics of groups of PER_GROUP channels: the values, or their squared differences from the means
// if SQUARES is 1.
#import gpu::column_sums
#const PER_GROUP, SQUARES

@group(0) @binding(2) var<storage, read> x: array<f32>;
@group(0) @binding(3) var<storage, read> means: array<f32>;

fn terms(pixel: u32, channel: u32) -> vec2<f32> {
    let value = x[pixel * sums.columns + channel];
    if (SQUARES == 0u) {
        return vec2<f32>(value, 0.0);
    }
    let difference = value - means[channel / PER_GROUP];
    return vec2<f32>(difference * difference, 0.0);
}
