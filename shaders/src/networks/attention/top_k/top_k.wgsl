// Sizes of attention to the best keys, and where the columns of a head lie.

struct TopK {
    queries: u32,
    keys: u32,
    heads: u32,
    // Columns per head.
    depth: u32,
    // Keys that exist, and that every query keeps.
    valid: u32,
    kept: u32,
    // 1 / √d.
    scale: f32,
}

@group(0) @binding(0) var<uniform> sizes: TopK;

fn columns_of(row: u32, head: u32) -> u32 {
    return (row * sizes.heads + head) * sizes.depth;
}

// Where the kept keys of a query and head begin.
fn kept_of(query: u32, head: u32) -> u32 {
    return (query * sizes.heads + head) * sizes.kept;
}

