// One invocation per element, in workgroups of 64, for kernels with many registers: calls `run` with the index of the
// element. The last workgroup may have invocations past the last element.
#import gpu::flat_group
#extern fn run(at: u32)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    run(flat_group(group, groups) * 64u + local);
}
