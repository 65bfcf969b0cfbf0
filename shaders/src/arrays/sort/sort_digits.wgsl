// Sizes and digits of a least-significant-digit radix sort. One pass orders the keys by a digit of eight bits.
#const COUNTED

struct Sort {
    // Capacity in keys, and in blocks of 1024 keys.
    len: u32,
    blocks: u32,
    // This pass, and all passes.
    pass_index: u32,
    passes: u32,
}

@group(0) @binding(0) var<uniform> sort: Sort;
// If COUNTED is 1, the first element is the number of keys.
@group(0) @binding(1) var<storage, read> length: array<u32>;

const BLOCK: u32 = 1024u;
const DIGITS: u32 = 256u;
const DIGIT_BITS: u32 = 8u;
const GROUP: u32 = 256u;
const ITEMS: u32 = 4u;

// The number of keys.
fn key_count() -> u32 {
    if (COUNTED == 1u) {
        return min(length[0], sort.len);
    }
    return sort.len;
}

// The digit of a key that a pass sorts by.
fn digit_of(key: u32, of_pass: u32) -> u32 {
    return (key >> (DIGIT_BITS * of_pass)) & (DIGITS - 1u);
}

// Place of the count of a pass, [pass, digit, block].
fn count_at(of_pass: u32, digit: u32, block: u32) -> u32 {
    return (of_pass * DIGITS + digit) * sort.blocks + block;
}
