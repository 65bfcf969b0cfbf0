// Sizes of top-k attention, and the indices of a head's columns and kept keys.

struct TopK {
    queries: u32,
    keys: u32,
    heads: u32,
    // Columns per head.
    depth: u32,
    // Keys that may be attended to, and keys that every query keeps.
    valid: u32,
    kept: u32,
    // 1 / √d.
    scale: f32,
}

@group(0) @binding(0) var<uniform> sizes: TopK;

fn columns_of(row: u32, head: u32) -> u32 {
    return (row * sizes.heads + head) * sizes.depth;
}

// Index of the first kept key of a query and head.
fn kept_of(query: u32, head: u32) -> u32 {
    return (query * sizes.heads + head) * sizes.kept;
}
