// γ·(x − μ)/√(σ² + ε) + β for groups of PER_GROUP channels. One invocation per value.
#import gpu::elements
#const PER_GROUP

struct GroupNorm {
    len: u32,
    channels: u32,
}

@group(0) @binding(0) var<uniform> sizes: GroupNorm;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> scale: array<f32>;
@group(0) @binding(3) var<storage, read> shift: array<f32>;
@group(0) @binding(4) var<storage, read> means: array<f32>;
@group(0) @binding(5) var<storage, read> inverses: array<f32>;
@group(0) @binding(6) var<storage, read_write> y: array<f32>;

fn run(at: u32) {
    if (at >= sizes.len) {
        return;
    }
    let channel = at % sizes.channels;
    let of_group = channel / PER_GROUP;
    // Subtracts the mean first, to avoid cancellation with a large mean.
    y[at] = scale[channel] * inverses[of_group] * (x[at] - means[of_group]) + shift[channel];
}
