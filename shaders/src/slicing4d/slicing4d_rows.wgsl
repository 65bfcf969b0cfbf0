// Of which Gaussians enough of the opacity is left at the instant: a bit each.

@group(0) @binding(7) var<storage, read_write> words: array<u32>;

var<workgroup> group_words: array<atomic<u32>, 8>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < 8u) {
        atomicStore(&group_words[local], 0u);
    }
    workgroupBarrier();
    let row = flat_group(group, groups) * 256u + local;
    if (row < slicing.count) {
        let gaussian = gaussian_of(row);
        let time_row = time_row_of(axes_of(gaussian).lengths[3]);
        if (log_share(gaussian.offset_time, time_row.deviation) > slicing.least_log_share) {
            atomicOr(&group_words[local / 32u], 1u << (local % 32u));
        }
    }
    workgroupBarrier();
    let word = flat_group(group, groups) * 8u + local;
    if (local < 8u && word < arrayLength(&words)) {
        words[word] = atomicLoad(&group_words[local]);
    }
}
