// Writes the `length` of a list: the number of elements in use, the number wanted, and the indirect dispatches over
// those in use, with 256 and with 1024 elements per workgroup. A dispatch has at least one workgroup, because a kernel
// may have output even for an empty list. Dispatches above the limit of one dimension are folded into two.
#extern var<storage, read_write> length: array<u32>

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
