// One workgroup per digit: the counts of its blocks become the number of keys of that digit in earlier blocks, and their
// sum is the digit's total.

@group(0) @binding(2) var<storage, read_write> counts: array<u32>;
@group(0) @binding(3) var<storage, read_write> totals: array<u32>;

var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let digit = flat_group(group, groups);
    let blocks = (key_count() + BLOCK - 1u) / BLOCK;
    var before = 0u;
    for (var start = 0u; start < blocks; start += GROUP) {
        let block = start + local;
        var own = 0u;
        if (block < blocks && digit < DIGITS) {
            own = counts[digit * sort.blocks + block];
        }
        // Inclusive sums over the invocations, by doubling distances.
        partial[local] = own;
        workgroupBarrier();
        for (var distance = 1u; distance < GROUP; distance *= 2u) {
            var left = 0u;
            if (local >= distance) {
                left = partial[local - distance];
            }
            workgroupBarrier();
            partial[local] += left;
            workgroupBarrier();
        }
        if (block < blocks && digit < DIGITS) {
            counts[digit * sort.blocks + block] = before + partial[local] - own;
        }
        before += partial[GROUP - 1u];
        workgroupBarrier();
    }
    if (local == 0u && digit < DIGITS) {
        totals[digit] = before;
    }
}
