// Gradients of keys and values. A workgroup sums 64 columns of one key and head over the queries in order: the columns
// of the key, then those of the value. Bit 0 of ARRIVING is set if the attention output has a gradient.
//
// In each round of 64 queries, an invocation first looks up one query's score gradient and probability for the key,
// then acts as one column.
#import gpu::flat_group
#import gpu::nowhere
#import networks::attention::top_k::kept_key_search
#import networks::attention::top_k::top_k_sizes
#const ARRIVING

@group(0) @binding(1) var<storage, read> query: array<f32>;
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
@group(0) @binding(3) var<storage, read> probabilities: array<f32>;
@group(0) @binding(4) var<storage, read> g_scores: array<f32>;
@group(0) @binding(5) var<storage, read> g_mixed: array<f32>;
@group(0) @binding(6) var<storage, read_write> g_key: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_value: array<f32>;

const GROUP: u32 = 64u;

// Score gradient and probability of every query of the round.
var<workgroup> kept_terms: array<vec2<f32>, GROUP>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tiles = (2u * sizes.depth + GROUP - 1u) / GROUP;
    let index = flat_group(group, groups) / tiles;
    let key = index / sizes.heads;
    let head = index % sizes.heads;
    let column = flat_group(group, groups) % tiles * GROUP + local;
    let of_value = column >= sizes.depth;
    var sum = 0.0;
    for (var first = 0u; first < sizes.queries; first += GROUP) {
        workgroupBarrier();
        kept_terms[local] = vec2<f32>(0.0);
        if (first + local < sizes.queries) {
            let place = place_of(kept_of(first + local, head), key);
            if (place != NOWHERE) {
                kept_terms[local] = vec2<f32>(g_scores[place], probabilities[place]);
            }
        }
        workgroupBarrier();
        let end = min(GROUP, sizes.queries - first);
        for (var at = 0u; at < end; at++) {
            let terms = kept_terms[at];
            // Most queries do not keep this key.
            if (terms.y == 0.0 || column >= 2u * sizes.depth) {
                continue;
            }
            let columns = columns_of(first + at, head);
            if (!of_value) {
                sum += terms.x * query[columns + column];
            } else if ((ARRIVING & 1u) != 0u) {
                sum += terms.y * g_mixed[columns + column - sizes.depth];
            }
        }
    }
    if (key < sizes.keys && column < 2u * sizes.depth) {
        if (of_value) {
            g_value[columns_of(key, head) + column - sizes.depth] = sum;
        } else {
            g_key[columns_of(key, head) + column] = sum;
        }
    }
}
