// The gradients of queries, keys and values: an invocation per row and head, which goes through the row's queries in order.

@group(0) @binding(4) var<storage, read> dy: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_queries: array<f32>;
@group(0) @binding(6) var<storage, read_write> g_keys: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_values: array<f32>;

// The gradient of the scores before they are scaled, times the scale.
fn score_gradients(row: u32, token: u32, head: u32, weights: array<f32, WINDOW>) -> array<f32, WINDOW> {
    var p = weights;
    var gradients: array<f32, WINDOW>;
    let out = looking_at(row, token, head);
    var mean = 0.0;
    for (var at = 0u; at < WINDOW; at++) {
        let value = seen_at(row, at, head);
        var along = 0.0;
        for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
            along += dy[out + channel] * values[value + channel];
        }
        gradients[at] = along;
        mean += p[at] * along;
    }
    for (var at = 0u; at < WINDOW; at++) {
        gradients[at] = sizes.factor * p[at] * (gradients[at] - mean);
    }
    return gradients;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 64u + local;
    if (index >= sizes.rows * sizes.heads) {
        return;
    }
    let head = index % sizes.heads;
    let row = index / sizes.heads;
    for (var token = 0u; token < sizes.queries; token++) {
        var weights = probabilities(row, token, head);
        var gradients = score_gradients(row, token, head, weights);
        let query = looking_at(row, token, head);
        for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
            var g_query = 0.0;
            for (var at = 0u; at < WINDOW; at++) {
                let seen = seen_at(row, at, head) + channel;
                g_query += gradients[at] * keys[seen];
                let g_key = gradients[at] * queries[query + channel];
                let g_value = weights[at] * dy[query + channel];
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
