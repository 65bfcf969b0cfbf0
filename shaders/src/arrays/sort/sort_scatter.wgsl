// Moves every key and its value to the position given by one digit. The sort is stable. If FIRST is 1, the values are
// the indices of the keys. Unless this pass is the LAST, the digits of the next pass are counted in the keys' new
// blocks. If SUMMED is 1, the counts of this pass are already sums over earlier blocks; otherwise, every workgroup adds
// them up. One workgroup per block.
//
// A block is first sorted in workgroup memory, by the lower and then the higher four bits of the digit, so that
// neighbouring invocations write to neighbouring positions.
#import arrays::sort::sort_digits
#import gpu::flat_group
#const FIRST, LAST, SUMMED

@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
// [digit], if SUMMED is 1.
@group(0) @binding(4) var<storage, read> totals: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> sorted_values: array<u32>;
@group(0) @binding(7) var<storage, read_write> block_counts: array<atomic<u32>>;

// The digits of a block's keys. The lower ten bits are the index of the key in the block.
var<workgroup> items: array<u32, 1024>;
// Per invocation, counts of the sixteen values of a half digit, two to a word: the first eight, then the others.
var<workgroup> counts: array<vec4<u32>, 512>;
// Index of the block's first key of each digit among all sorted keys, and in the block.
var<workgroup> global_starts: array<u32, 256>;
var<workgroup> local_starts: array<u32, 256>;

// A count of one for a half digit, in its half of its word.
fn one_for(half_digit: u32) -> array<vec4<u32>, 2> {
    let word = half_digit / 2u;
    let one = 1u << (16u * (half_digit % 2u));
    let low = select(vec4<u32>(), vec4<u32>(one), vec4<u32>(word) == vec4<u32>(0u, 1u, 2u, 3u));
    let high = select(vec4<u32>(), vec4<u32>(one), vec4<u32>(word) == vec4<u32>(4u, 5u, 6u, 7u));
    return array<vec4<u32>, 2>(low, high);
}

// Extracts the count of a half digit.
fn count_of(low: vec4<u32>, high: vec4<u32>, half_digit: u32) -> u32 {
    let ones = one_for(half_digit);
    let mask = array<vec4<u32>, 2>(ones[0] * 0xffffu, ones[1] * 0xffffu);
    let found = (low & mask[0]) | (high & mask[1]);
    let word = found.x | found.y | found.z | found.w;
    return word >> (16u * (half_digit % 2u));
}

// Exclusive prefix sums over the sixteen counts, two to a word.
fn starts_of(totals_low: vec4<u32>, totals_high: vec4<u32>) -> array<vec4<u32>, 2> {
    var words = array<u32, 8>(
        totals_low.x, totals_low.y, totals_low.z, totals_low.w,
        totals_high.x, totals_high.y, totals_high.z, totals_high.w,
    );
    var running = 0u;
    for (var word = 0u; word < 8u; word++) {
        let even = words[word] & 0xffffu;
        let odd = words[word] >> 16u;
        words[word] = running | ((running + even) << 16u);
        running += even + odd;
    }
    return array<vec4<u32>, 2>(
        vec4<u32>(words[0], words[1], words[2], words[3]),
        vec4<u32>(words[4], words[5], words[6], words[7]),
    );
}

// Sorts the block by four bits of its digits; the sort is stable. Each invocation has four consecutive items.
fn sort_block(local: u32, shift: u32) {
    var own: array<u32, 4>;
    var low = vec4<u32>();
    var high = vec4<u32>();
    for (var item = 0u; item < ITEMS; item++) {
        own[item] = items[local * ITEMS + item];
        let one = one_for((own[item] >> (10u + shift)) & 15u);
        low += one[0];
        high += one[1];
    }
    counts[local] = low;
    counts[GROUP + local] = high;
    workgroupBarrier();
    for (var distance = 1u; distance < GROUP; distance *= 2u) {
        var left_low = vec4<u32>();
        var left_high = vec4<u32>();
        if (local >= distance) {
            left_low = counts[local - distance];
            left_high = counts[GROUP + local - distance];
        }
        workgroupBarrier();
        counts[local] += left_low;
        counts[GROUP + local] += left_high;
        workgroupBarrier();
    }
    let starts = starts_of(counts[GROUP - 1u], counts[2u * GROUP - 1u]);
    // Destination of this invocation's next item of each half digit.
    var next_low = starts[0] + counts[local] - low;
    var next_high = starts[1] + counts[GROUP + local] - high;
    for (var item = 0u; item < ITEMS; item++) {
        let half_digit = (own[item] >> (10u + shift)) & 15u;
        items[count_of(next_low, next_high, half_digit)] = own[item];
        let one = one_for(half_digit);
        next_low += one[0];
        next_high += one[1];
    }
    workgroupBarrier();
}

// Keys of a digit: in earlier blocks, and in all.
fn keys_of(digit: u32, block: u32) -> vec2<u32> {
    if (SUMMED == 1u) {
        return vec2<u32>(atomicLoad(&block_counts[count_at(sort.pass_index, digit, block)]), totals[digit]);
    }
    var earlier = 0u;
    var all = 0u;
    for (var other = 0u; other * BLOCK < key_count(); other++) {
        if (other == block) {
            earlier = all;
        }
        all += atomicLoad(&block_counts[count_at(sort.pass_index, digit, other)]);
    }
    return vec2<u32>(earlier, all);
}

// Index of the block's first key of each digit among all sorted keys.
fn find_global_starts(local: u32, block: u32) {
    let own = keys_of(local, block);
    global_starts[local] = own.y;
    workgroupBarrier();
    // Inclusive prefix sums over the digits, by doubling distances.
    for (var distance = 1u; distance < GROUP; distance *= 2u) {
        var left = 0u;
        if (local >= distance) {
            left = global_starts[local - distance];
        }
        workgroupBarrier();
        global_starts[local] += left;
        workgroupBarrier();
    }
    global_starts[local] += own.x - own.y;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    let first = block * BLOCK;
    for (var item = 0u; item < ITEMS; item++) {
        let place = item * GROUP + local;
        // Items past the end sort after every key.
        var digit = DIGITS - 1u;
        if (first + place < key_count()) {
            digit = digit_of(keys[first + place], sort.pass_index);
        }
        items[place] = (digit << 10u) | place;
    }
    find_global_starts(local, block);
    workgroupBarrier();
    sort_block(local, 0u);
    sort_block(local, 4u);
    for (var item = 0u; item < ITEMS; item++) {
        let at = local * ITEMS + item;
        let digit = items[at] >> 10u;
        if (at == 0u || items[max(at, 1u) - 1u] >> 10u != digit) {
            local_starts[digit] = at;
        }
    }
    workgroupBarrier();

    for (var item = 0u; item < ITEMS; item++) {
        let at = item * GROUP + local;
        let digit = items[at] >> 10u;
        let index = first + (items[at] & (BLOCK - 1u));
        if (index < key_count()) {
            let to = global_starts[digit] + at - local_starts[digit];
            let key = keys[index];
            sorted_keys[to] = key;
            if (LAST == 0u) {
                let next = sort.pass_index + 1u;
                // Integer additions do not depend on the order.
                atomicAdd(&block_counts[count_at(next, digit_of(key, next), to / BLOCK)], 1u);
            }
            if (FIRST == 1u) {
                sorted_values[to] = index;
            } else {
                sorted_values[to] = values[index];
            }
        }
    }
}
