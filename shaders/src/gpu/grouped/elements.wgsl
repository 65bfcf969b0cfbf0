// One invocation per element of every item, in workgroups of 256: calls `run` with the item and the index of the
// element in the item. The last workgroup of an item may have invocations past the last element.
#import gpu::flat_group
#import gpu::grouped::grouped
#extern fn run(item: u32, at: u32)

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    run(item, (flat - first_group(item)) * 256u + local);
}
