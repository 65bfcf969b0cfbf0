// Attention of one query of one head to its window of WINDOW tokens: the same definitions as on the CPU.
#const WINDOW
#extern fn hold_weight(at: u32, value: f32)
#extern fn weight_at(at: u32) -> f32

struct Window {
    rows: u32,
    // Query tokens per row.
    queries: u32,
    // Of all heads.
    channels: u32,
    heads: u32,
    // 1 / √d.
    factor: f32,
}

@group(0) @binding(0) var<uniform> sizes: Window;
@group(0) @binding(1) var<storage, read> queries: array<f32>;
@group(0) @binding(2) var<storage, read> keys: array<f32>;
@group(0) @binding(3) var<storage, read> values: array<f32>;

// Index of the first channel of a head of a window token.
fn window_channel(row: u32, at: u32, head: u32) -> u32 {
    return (row * WINDOW + at) * sizes.channels + head * (sizes.channels / sizes.heads);
}

// Index of the first channel of a head of a query token.
fn query_channel(row: u32, token: u32, head: u32) -> u32 {
    return (row * sizes.queries + token) * sizes.channels + head * (sizes.channels / sizes.heads);
}

// Computes and holds the attention weight of a query to every token of the window.
fn hold_weights(row: u32, token: u32, head: u32) {
    let query = query_channel(row, token, head);
    var largest = 0.0;
    for (var at = 0u; at < WINDOW; at++) {
        let key = window_channel(row, at, head);
        var score = 0.0;
        for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
            score += queries[query + channel] * keys[key + channel];
        }
        score *= sizes.factor;
        hold_weight(at, score);
        largest = select(max(largest, score), score, at == 0u);
    }
    var sum = 0.0;
    for (var at = 0u; at < WINDOW; at++) {
        let weight = exp(weight_at(at) - largest);
        hold_weight(at, weight);
        sum += weight;
    }
    for (var at = 0u; at < WINDOW; at++) {
        hold_weight(at, weight_at(at) / sum);
    }
}
