// One invocation per element, in workgroups of 256: calls `run` with the index of the element. The last workgroup may
// have invocations past the last element.
#import gpu::flat_group
#extern fn run(at: u32)

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    run(flat_group(group, groups) * 256u + local);
}
