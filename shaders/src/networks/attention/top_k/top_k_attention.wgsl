// Selects the keys with the highest scores, and computes the attention probabilities and the output. One workgroup per
// query and head.
//
// The score threshold is found by radix selection. Of the keys whose score equals it, the first ones are kept.
#import gpu::column_sum
#import gpu::flat_group
#import gpu::row_sum
#import networks::attention::top_k::top_k_sizes
#const COLUMNS

@group(0) @binding(1) var<storage, read> query: array<f32>;
@group(0) @binding(2) var<storage, read> key: array<f32>;
@group(0) @binding(3) var<storage, read> value: array<f32>;
@group(0) @binding(4) var<storage, read> valid: array<u32>;
// [queries, heads, valid].
@group(0) @binding(5) var<storage, read_write> scores: array<f32>;
// [queries, heads, kept].
@group(0) @binding(6) var<storage, read_write> chosen: array<u32>;
@group(0) @binding(7) var<storage, read_write> probabilities: array<f32>;
@group(0) @binding(8) var<storage, read_write> mixed: array<f32>;

const GROUP: u32 = 256u;
const DIGITS: u32 = 16u;
const DIGIT_BITS: u32 = 4u;

var<workgroup> counts: array<atomic<u32>, DIGITS>;
var<workgroup> before: array<u32, GROUP>;
var<workgroup> maxima: array<f32, GROUP>;

// Maps a float to an integer with the same order, −0 before +0.
fn ordered(score: f32) -> u32 {
    let bits = bitcast<u32>(score);
    return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

// The smallest score that is kept, and how many of the keys with this score are kept.
fn threshold(local: u32, first: u32) -> vec2<u32> {
    var prefix = 0u;
    var remaining = sizes.kept;
    for (var pass_of = 0u; pass_of < 32u / DIGIT_BITS; pass_of++) {
        let shift = 32u - DIGIT_BITS * (pass_of + 1u);
        workgroupBarrier();
        if (local < DIGITS) {
            atomicStore(&counts[local], 0u);
        }
        workgroupBarrier();
        for (var at = local; at < sizes.valid; at += GROUP) {
            let bits = ordered(scores[first + at]);
            if (pass_of == 0u || (bits >> (shift + DIGIT_BITS)) == prefix) {
                atomicAdd(&counts[(bits >> shift) % DIGITS], 1u);
            }
        }
        workgroupBarrier();
        var digit = DIGITS - 1u;
        while (digit > 0u && atomicLoad(&counts[digit]) < remaining) {
            remaining -= atomicLoad(&counts[digit]);
            digit -= 1u;
        }
        prefix = prefix * DIGITS + digit;
    }
    return vec2<u32>(prefix, remaining);
}

// Inclusive prefix sum of `count` over the invocations of the workgroup.
fn inclusive_sum(local: u32, count: u32) -> u32 {
    workgroupBarrier();
    before[local] = count;
    workgroupBarrier();
    for (var distance = 1u; distance < GROUP; distance *= 2u) {
        var left = 0u;
        if (local >= distance) {
            left = before[local - distance];
        }
        workgroupBarrier();
        before[local] += left;
        workgroupBarrier();
    }
    return before[local];
}

// Writes the kept keys in ascending order and their scaled scores.
fn choose(local: u32, first: u32, kept_at: u32) {
    let limit = threshold(local, first);
    // Number of keys so far above the threshold and equal to it.
    var above = 0u;
    var equal = 0u;
    for (var start = 0u; start < sizes.valid; start += GROUP) {
        let at = start + local;
        var is_above = 0u;
        var is_equal = 0u;
        if (at < sizes.valid) {
            let bits = ordered(scores[first + at]);
            is_above = u32(bits > limit.x);
            is_equal = u32(bits == limit.x);
        }
        // Both counts fit one integer, because neither exceeds the workgroup size.
        let sum = inclusive_sum(local, is_above + (is_equal << 16u));
        let above_before = above + (sum & 0xffffu) - is_above;
        let equal_before = equal + (sum >> 16u) - is_equal;
        if (is_above == 1u || (is_equal == 1u && equal_before < limit.y)) {
            let place = kept_at + above_before + min(equal_before, limit.y);
            chosen[place] = valid[at];
            probabilities[place] = sizes.scale * scores[first + at];
        }
        workgroupBarrier();
        above += before[GROUP - 1u] & 0xffffu;
        equal += before[GROUP - 1u] >> 16u;
    }
}

fn largest_kept(local: u32, kept_at: u32) -> f32 {
    // Invocations without a kept key use the first one.
    var largest = probabilities[kept_at];
    for (var at = local; at < sizes.kept; at += GROUP) {
        largest = max(largest, probabilities[kept_at + at]);
    }
    maxima[local] = largest;
    workgroupBarrier();
    for (var distance = GROUP / 2u; distance > 0u; distance /= 2u) {
        if (local < distance) {
            maxima[local] = max(maxima[local], maxima[local + distance]);
        }
        workgroupBarrier();
    }
    return maxima[0];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups);
    if (index >= sizes.queries * sizes.heads) {
        return;
    }
    let head = index % sizes.heads;
    let own = columns_of(index / sizes.heads, head);
    let first = index * sizes.valid;
    let kept_at = index * sizes.kept;
    for (var at = local; at < sizes.valid; at += GROUP) {
        let columns = columns_of(valid[at], head);
        var score = 0.0;
        for (var column = 0u; column < sizes.depth; column++) {
            score += query[own + column] * key[columns + column];
        }
        scores[first + at] = score;
    }
    choose(local, first, kept_at);
    storageBarrier();
    workgroupBarrier();

    // Softmax.
    let largest = largest_kept(local, kept_at);
    var sum = 0.0;
    for (var at = local; at < sizes.kept; at += GROUP) {
        sum += exp(probabilities[kept_at + at] - largest);
    }
    let total = row_sum(local, sum);
    for (var at = local; at < sizes.kept; at += GROUP) {
        probabilities[kept_at + at] = exp(probabilities[kept_at + at] - largest) / total;
    }
    storageBarrier();
    workgroupBarrier();

    for (var tile = 0u; tile < sizes.depth; tile += COLUMNS) {
        let column = tile + local % COLUMNS;
        var seen = 0.0;
        if (column < sizes.depth) {
            for (var at = kept_at + local / COLUMNS; at < kept_at + sizes.kept; at += GROUP / COLUMNS) {
                seen += probabilities[at] * value[columns_of(chosen[at], head) + column];
            }
        }
        let of_column = column_sum(local, seen);
        if (local < COLUMNS && column < sizes.depth) {
            mixed[own + column] = of_column;
        }
    }
}
