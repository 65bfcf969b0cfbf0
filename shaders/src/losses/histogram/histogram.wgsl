// The soft histogram of every block of values. One workgroup per block and COLUMNS bins; COLUMNS is a power of two, at
// most 256. In each round of 256 values, an invocation first finds the bins of one value, then acts as a bin and sums
// every (256 / COLUMNS)-th value.
#import gpu::column_sum
#import gpu::flat_group
#import gpu::nowhere
#import losses::histogram::histogram_bins
#const COLUMNS

@group(0) @binding(2) var<storage, read_write> block_shares: array<f32>;

const GROUP: u32 = 256u;
const BLOCK: u32 = 4096u;

// The lower bin of each value, and the shares of the lower and the upper bin.
var<workgroup> lowers: array<u32, GROUP>;
var<workgroup> parts: array<vec2<f32>, GROUP>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tiles = (sizes.bins + COLUMNS - 1u) / COLUMNS;
    let block = flat_group(group, groups) / tiles;
    let bin = flat_group(group, groups) % tiles * COLUMNS + local % COLUMNS;
    var own = 0.0;
    for (var first = 0u; first < BLOCK; first += GROUP) {
        let at = block * BLOCK + first + local;
        workgroupBarrier();
        lowers[local] = NOWHERE;
        if (at < sizes.len) {
            let place = place_of(x[at]);
            lowers[local] = place.lower;
            parts[local] = vec2<f32>(1.0 - place.upper_part, place.upper_part);
        }
        workgroupBarrier();
        for (var value = local / COLUMNS; value < GROUP; value += GROUP / COLUMNS) {
            if (lowers[value] == bin) {
                own += parts[value].x;
            } else if (lowers[value] != NOWHERE && lowers[value] + 1u == bin) {
                own += parts[value].y;
            }
        }
    }
    let sum = column_sum(local, own);
    if (local < COLUMNS && bin < sizes.bins && block < sizes.blocks) {
        block_shares[block * sizes.bins + bin] = sizes.share * sum;
    }
}
