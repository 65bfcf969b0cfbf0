// The gradient of every element of the render: its share of the mean, with the sign of the difference. One invocation
// per element.

struct Distance {
    len: u32,
    factor: f32,
}

@group(0) @binding(0) var<uniform> l1: Distance;
@group(0) @binding(1) var<storage, read> render: array<f32>;
@group(0) @binding(2) var<storage, read> image: array<f32>;
@group(0) @binding(3) var<storage, read> dy: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_render: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = flat_group(group, groups) * 256u + local;
    if (at < l1.len) {
        g_render[at] = l1.factor * dy[0] * sign(render[at] - image[at]);
    }
}
