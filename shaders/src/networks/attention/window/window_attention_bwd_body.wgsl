// Gradients of queries, keys and values. One invocation per row and head, which visits the row's queries in order.
#import gpu::elements_64
#import networks::attention::window::window_weights
#const WINDOW
#extern fn hold_for(index: u32, invocations: u32)
#extern fn weight_at(at: u32) -> f32
#extern fn hold_gradient(at: u32, value: f32)
#extern fn gradient_at(at: u32) -> f32

@group(0) @binding(4) var<storage, read> dy: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_queries: array<f32>;
@group(0) @binding(6) var<storage, read_write> g_keys: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_values: array<f32>;

// Computes and holds the gradients of the unscaled scores.
fn differentiate(row: u32, token: u32, head: u32) {
    let out = query_channel(row, token, head);
    var mean = 0.0;
    for (var at = 0u; at < WINDOW; at++) {
        let value = window_channel(row, at, head);
        var along = 0.0;
        for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
            along += dy[out + channel] * values[value + channel];
        }
        hold_gradient(at, along);
        mean += weight_at(at) * along;
    }
    for (var at = 0u; at < WINDOW; at++) {
        hold_gradient(at, sizes.factor * weight_at(at) * (gradient_at(at) - mean));
    }
}

fn run(index: u32) {
    if (index >= sizes.rows * sizes.heads) {
        return;
    }
    let head = index % sizes.heads;
    let row = index / sizes.heads;
    hold_for(index, sizes.rows * sizes.heads);
    for (var token = 0u; token < sizes.queries; token++) {
        hold_weights(row, token, head);
        differentiate(row, token, head);
        let query = query_channel(row, token, head);
        for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
            var g_query = 0.0;
            for (var at = 0u; at < WINDOW; at++) {
                let seen = window_channel(row, at, head) + channel;
                g_query += gradient_at(at) * keys[seen];
                let g_key = gradient_at(at) * queries[query + channel];
                let g_value = weight_at(at) * dy[query + channel];
                if (token == 0u) {
                    g_keys[seen] = g_key;
                    g_values[seen] = g_value;
                } else {
                    g_keys[seen] += g_key;
                    g_values[seen] += g_value;
                }
            }
            g_queries[query + channel] = g_query;
        }
    }
}
