// The index of what is not there.
const NOWHERE: u32 = 0xffffffffu;

// The number of a workgroup in a dispatch that was folded into two dimensions.
fn flat_group(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.x + group.y * groups.x;
}

