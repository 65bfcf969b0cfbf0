// Exclusive prefix sums, per digit, of the blocks' counts in this pass, and the digit's total. LANES invocations share a
// digit; LANES is a power of two, at most 256, near the number of blocks.
#import arrays::sort::sort_digits
#import gpu::flat_group
#const LANES

@group(0) @binding(2) var<storage, read_write> counts: array<u32>;
@group(0) @binding(3) var<storage, read_write> totals: array<u32>;

var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let digit = (flat_group(group, groups) * GROUP + local) / LANES;
    let lane = local % LANES;
    let blocks = (key_count() + BLOCK - 1u) / BLOCK;
    var before = 0u;
    for (var start = 0u; start < blocks; start += LANES) {
        let is_block = start + lane < blocks && digit < DIGITS;
        let at = count_at(sort.pass_index, digit, start + lane);
        var own = 0u;
        if (is_block) {
            own = counts[at];
        }
        // Inclusive prefix sums over the invocations of a digit, by doubling distances.
        partial[local] = own;
        workgroupBarrier();
        for (var distance = 1u; distance < LANES; distance *= 2u) {
            var left = 0u;
            if (lane >= distance) {
                left = partial[local - distance];
            }
            workgroupBarrier();
            partial[local] += left;
            workgroupBarrier();
        }
        if (is_block) {
            counts[at] = before + partial[local] - own;
        }
        before += partial[local - lane + LANES - 1u];
        workgroupBarrier();
    }
    if (lane == 0u && digit < DIGITS) {
        totals[digit] = before;
    }
}
