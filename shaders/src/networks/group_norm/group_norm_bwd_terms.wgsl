// The terms of the gradients of β and γ for groups of PER_GROUP channels: dy and dy·x̂.
#import gpu::column_sums
#const PER_GROUP

@group(0) @binding(2) var<storage, read> x: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read> means: array<f32>;
@group(0) @binding(5) var<storage, read> inverses: array<f32>;

fn terms(pixel: u32, channel: u32) -> vec2<f32> {
    let at = pixel * sums.columns + channel;
    let normalized = (x[at] - means[channel / PER_GROUP]) * inverses[channel / PER_GROUP];
    return dy[at] * vec2<f32>(1.0, normalized);
}
