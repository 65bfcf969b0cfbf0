// The random sort key of every row, below 2³¹ for candidates and NOWHERE for others: the same definitions as on the
// CPU. One invocation per row.
#import gpu::elements
#import gpu::nowhere

struct Keys {
    rows: u32,
    seed: u32,
}

@group(0) @binding(0) var<uniform> draw: Keys;
@group(0) @binding(1) var<storage, read> candidates: array<f32>;
@group(0) @binding(2) var<storage, read_write> keys: array<u32>;

fn scrambled(bits: u32) -> u32 {
    let first = (bits ^ (bits >> 16u)) * 0x85ebca6bu;
    let second = (first ^ (first >> 13u)) * 0xc2b2ae35u;
    return second ^ (second >> 16u);
}

fn run(row: u32) {
    if (row < draw.rows) {
        let key = scrambled(scrambled(row) ^ draw.seed) >> 1u;
        keys[row] = select(NOWHERE, key, candidates[row] > 0.0);
    }
}
