// 1 for positions within the image that sample finite texels only, otherwise 0. One invocation per position.

@group(0) @binding(3) var<storage, read_write> valid: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = flat_group(group, groups) * 64u + local;
    if (at < sizes.count) {
        valid[at] = f32(window_of(pixels[at]).valid);
    }
}
