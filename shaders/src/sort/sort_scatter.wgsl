// Moves every key with its value to its place by one digit; keys of equal digit keep their order. FIRST is 1 where the
// values are the places of the keys themselves.

struct Sort {
    len: u32,
    blocks: u32,
    shift: u32,
}

@group(0) @binding(0) var<uniform> sort: Sort;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
// [digit, block]: where the keys of that digit in that block begin.
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> sorted_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted_values: array<u32>;

const GROUP: u32 = 128u;
const ITEMS: u32 = 8u;
const DIGITS: u32 = 16u;

// [digit, invocation]: keys of that digit, then where they begin among all keys of the block in sorted order.
var<workgroup> places: array<u32, 2048>;
var<workgroup> partial: array<u32, 128>;
var<workgroup> starts: array<u32, 16>;

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = flat_group(group, groups);
    for (var digit = 0u; digit < DIGITS; digit++) {
        places[digit * GROUP + local] = 0u;
    }
    // Each invocation has consecutive keys, so that places in order of invocations are in the order of keys.
    let first = (block * GROUP + local) * ITEMS;
    for (var item = 0u; item < ITEMS; item++) {
        if (first + item < sort.len) {
            let digit = (keys[first + item] >> sort.shift) & 15u;
            places[digit * GROUP + local] += 1u;
        }
    }
    workgroupBarrier();

    // Exclusive sums over [digit, invocation]: 16 consecutive counts per invocation, then over the invocations.
    var own = 0u;
    for (var at = 0u; at < DIGITS; at++) {
        own += places[local * DIGITS + at];
    }
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
    var running = partial[local] - own;
    for (var at = 0u; at < DIGITS; at++) {
        let count = places[local * DIGITS + at];
        places[local * DIGITS + at] = running;
        running += count;
    }
    workgroupBarrier();
    if (local < DIGITS) {
        starts[local] = places[local * GROUP];
    }
    workgroupBarrier();

    for (var item = 0u; item < ITEMS; item++) {
        let index = first + item;
        if (index < sort.len && block < sort.blocks) {
            let key = keys[index];
            let digit = (key >> sort.shift) & 15u;
            let place = places[digit * GROUP + local];
            places[digit * GROUP + local] = place + 1u;
            let to = offsets[digit * sort.blocks + block] + place - starts[digit];
            sorted_keys[to] = key;
            if (FIRST == 1u) {
                sorted_values[to] = index;
            } else {
                sorted_values[to] = values[index];
            }
        }
    }
}
