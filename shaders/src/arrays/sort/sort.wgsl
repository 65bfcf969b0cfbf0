// What the kernels of a sort share: one pass moves keys by a digit of eight bits.

struct Sort {
    // The capacity in keys, and the blocks of 1024 of them.
    len: u32,
    blocks: u32,
    // Where the digit lies in the key, and where that of the next pass.
    shift: u32,
    next_shift: u32,
}

@group(0) @binding(0) var<uniform> sort: Sort;
// Its first element is the number of keys, where COUNTED is 1.
@group(0) @binding(1) var<storage, read> length: array<u32>;

const BLOCK: u32 = 1024u;
const DIGITS: u32 = 256u;
const GROUP: u32 = 256u;
const ITEMS: u32 = 4u;

// The number of keys.
fn key_count() -> u32 {
    if (COUNTED == 1u) {
        return min(length[0], sort.len);
    }
    return sort.len;
}

fn digit_of(key: u32, shift: u32) -> u32 {
    return (key >> shift) & (DIGITS - 1u);
}
