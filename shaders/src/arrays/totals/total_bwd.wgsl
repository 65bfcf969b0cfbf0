// The gradient of a sum: the same value for every element. One invocation per element.

struct Spread {
    factor: f32,
}

@group(0) @binding(0) var<uniform> spread: Spread;
@group(0) @binding(1) var<storage, read> dy: array<f32>;
@group(0) @binding(2) var<storage, read_write> dx: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    if (index < arrayLength(&dx)) {
        dx[index] = spread.factor * dy[0];
    }
}
