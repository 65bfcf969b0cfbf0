// Sizes and digits of a least-significant-digit radix sort. One pass orders the keys by a digit of eight bits.
#const COUNTED

struct Sort {
    // Capacity in keys, and in blocks of 1024 keys.
    len: u32,
    blocks: u32,
    // Position of the digit in the key, in bits, in this pass and in the next one.
    shift: u32,
    next_shift: u32,
}

@group(0) @binding(0) var<uniform> sort: Sort;
// If COUNTED is 1, the first element is the number of keys.
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
