// The gradient of every element of the render: its share of the mean, with the sign of the difference. One invocation
// per element.
#import gpu::elements

struct Distance {
    len: u32,
    factor: f32,
}

@group(0) @binding(0) var<uniform> l1: Distance;
@group(0) @binding(1) var<storage, read> render: array<f32>;
@group(0) @binding(2) var<storage, read> image: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_render: array<f32>;

fn run(at: u32) {
    if (at < l1.len) {
        g_render[at] = l1.factor * dy[0] * sign(render[at] - image[at]);
    }
}
