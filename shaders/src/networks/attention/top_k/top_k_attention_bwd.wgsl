// Gradients of the kept scores, times the scale, and of the queries. One workgroup per query and head. ARRIVING is a
// bit mask of the upstream gradients that exist: the attention output, then the mean probabilities. The placeholder for
// a missing one is never read.
#import gpu::column_sum
#import gpu::flat_group
#import gpu::row_sum
#import networks::attention::top_k::top_k_sizes
#const ARRIVING, COLUMNS

@group(0) @binding(1) var<storage, read> key: array<f32>;
@group(0) @binding(2) var<storage, read> value: array<f32>;
@group(0) @binding(3) var<storage, read> chosen: array<u32>;
@group(0) @binding(4) var<storage, read> probabilities: array<f32>;
@group(0) @binding(5) var<storage, read> g_mixed: array<f32>;
@group(0) @binding(6) var<storage, read> g_mean: array<f32>;
// [queries, heads, kept].
@group(0) @binding(7) var<storage, read_write> g_scores: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_query: array<f32>;

const GROUP: u32 = 256u;

// The gradient of one attention probability.
fn arriving_at(query: u32, head: u32, seen: u32) -> f32 {
    var gradient = 0.0;
    if ((ARRIVING & 1u) != 0u) {
        let from_column = columns_of(query, head);
        let to_column = columns_of(seen, head);
        for (var column = 0u; column < sizes.depth; column++) {
            gradient += g_mixed[from_column + column] * value[to_column + column];
        }
    }
    if ((ARRIVING & 2u) != 0u) {
        gradient += g_mean[query * sizes.keys + seen] / f32(sizes.heads);
    }
    return gradient;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups);
    if (index >= sizes.queries * sizes.heads) {
        return;
    }
    let query = index / sizes.heads;
    let head = index % sizes.heads;
    let first = kept_of(query, head);
    var along = 0.0;
    for (var at = first + local; at < first + sizes.kept; at += GROUP) {
        g_scores[at] = arriving_at(query, head, chosen[at]);
        along += probabilities[at] * g_scores[at];
    }
    let mean = row_sum(local, along);
    for (var at = first + local; at < first + sizes.kept; at += GROUP) {
        g_scores[at] = sizes.scale * probabilities[at] * (g_scores[at] - mean);
    }
    storageBarrier();
    workgroupBarrier();

    for (var tile = 0u; tile < sizes.depth; tile += COLUMNS) {
        let column = tile + local % COLUMNS;
        var own = 0.0;
        if (column < sizes.depth) {
            for (var at = first + local / COLUMNS; at < first + sizes.kept; at += GROUP / COLUMNS) {
                own += g_scores[at] * key[columns_of(chosen[at], head) + column];
            }
        }
        let sum = column_sum(local, own);
        if (local < COLUMNS && column < sizes.depth) {
            g_query[columns_of(query, head) + column] = sum;
        }
    }
}
