// With x̂ = (x − μ)/√(σ² + ε) and g = γ·dy: dx = (g − mean(g) − x̂·mean(g·x̂))/√(σ² + ε). The means over the group of
// PER_GROUP channels follow from the gradients of β and γ. One invocation per value.
#import gpu::elements
#const PER_GROUP

struct GroupNorm {
    len: u32,
    channels: u32,
}

@group(0) @binding(0) var<uniform> sizes: GroupNorm;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> scale: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read> means: array<f32>;
@group(0) @binding(5) var<storage, read> inverses: array<f32>;
@group(0) @binding(6) var<storage, read> g_shift: array<f32>;
@group(0) @binding(7) var<storage, read> g_scale: array<f32>;
@group(0) @binding(8) var<storage, read_write> dx: array<f32>;

fn run(at: u32) {
    if (at >= sizes.len) {
        return;
    }
    let of_group = at % sizes.channels / PER_GROUP;
    var sum = vec2<f32>(0.0);
    for (var channel = of_group * PER_GROUP; channel < (of_group + 1u) * PER_GROUP; channel++) {
        sum += scale[channel] * vec2<f32>(g_shift[channel], g_scale[channel]);
    }
    let mean = sum / f32(sizes.len / sizes.channels * PER_GROUP);
    let normalized = (x[at] - means[of_group]) * inverses[of_group];
    dx[at] = (scale[at % sizes.channels] * dy[at] - mean.x - normalized * mean.y) * inverses[of_group];
}
