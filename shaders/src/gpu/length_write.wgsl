// Writes the `length` of a list: how many of its elements are used, how many are wanted, and the workgroups that have them,
// of 256 elements each, then of 1024; one at least, which may have something to say of nothing. More than a dimension
// allows are folded.

const MAX_GROUPS: u32 = 65535u;

fn write_groups(at: u32, count: u32, per_group: u32) {
    let groups = max((count + per_group - 1u) / per_group, 1u);
    let columns = min(groups, MAX_GROUPS);
    length[at] = columns;
    length[at + 1u] = (groups + columns - 1u) / columns;
    length[at + 2u] = 1u;
}

fn write_length(wanted: u32, capacity: u32) {
    length[0] = min(wanted, capacity);
    length[1] = wanted;
    write_groups(2u, min(wanted, capacity), 256u);
    write_groups(5u, min(wanted, capacity), 1024u);
}
