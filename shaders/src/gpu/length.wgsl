// How many elements of an array are used, how many are wanted, and the workgroups that have them: of 256 elements each,
// then of 1024; one at least, which may have something to say of nothing. More than a dimension allows are folded.

struct Place {
    // Where the number is, and what there is room for.
    at: u32,
    capacity: u32,
}

@group(0) @binding(0) var<uniform> place: Place;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> length: array<u32>;

const MAX_GROUPS: u32 = 65535u;

fn write_groups(at: u32, count: u32, per_group: u32) {
    let groups = max((count + per_group - 1u) / per_group, 1u);
    let columns = min(groups, MAX_GROUPS);
    length[at] = columns;
    length[at + 1u] = (groups + columns - 1u) / columns;
    length[at + 2u] = 1u;
}

@compute @workgroup_size(1)
fn main() {
    let wanted = counts[place.at];
    let count = min(wanted, place.capacity);
    length[0] = count;
    length[1] = wanted;
    write_groups(2u, count, 256u);
    write_groups(5u, count, 1024u);
}
