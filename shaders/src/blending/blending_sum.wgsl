// The gradients of every splat: its rows added in the order of its hits, then from moments to means, conics and opacities.

struct Sum {
    // Splats.
    count: u32,
}

@group(0) @binding(0) var<uniform> sizes: Sum;
@group(0) @binding(1) var<storage, read> rows: array<f32>;
@group(0) @binding(2) var<storage, read> entry_of_hit: array<u32>;
@group(0) @binding(3) var<storage, read> hit_starts: array<u32>;
@group(0) @binding(4) var<storage, read> rank_of_splat: array<u32>;
@group(0) @binding(5) var<storage, read> conics: array<f32>;
@group(0) @binding(6) var<storage, read> opacities: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_means2d: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_conics: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_opacities: array<f32>;
@group(0) @binding(10) var<storage, read_write> g_colors: array<f32>;
@group(0) @binding(11) var<storage, read_write> g_depths: array<f32>;
@group(0) @binding(12) var<storage, read_write> g_features: array<f32>;

const ROW: u32 = 9u + EXTRAS;
const FEATURES: u32 = EXTRAS - DEPTH;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let splat = flat_group(group, groups) * 64u + local;
    if (splat >= sizes.count) {
        return;
    }
    var row: array<f32, ROW>;
    let rank = rank_of_splat[splat];
    if (rank != NOWHERE) {
        let end = hit_starts[rank + 1u];
        for (var hit = hit_starts[rank]; hit < end; hit++) {
            let entry = entry_of_hit[hit];
            if (entry != NOWHERE) {
                for (var column = 0u; column < ROW; column++) {
                    row[column] += rows[entry * ROW + column];
                }
            }
        }
    }

    // Through e = dx + k·dy and σ = ½(A·e² + m·dy²).
    let a = conics[3u * splat];
    let k = conics[3u * splat + 1u];
    let m = conics[3u * splat + 2u];
    g_means2d[2u * splat] = a * row[1];
    g_means2d[2u * splat + 1u] = a * k * row[1] + m * row[4];
    g_conics[3u * splat] = 0.5 * row[2];
    g_conics[3u * splat + 1u] = a * row[3];
    g_conics[3u * splat + 2u] = 0.5 * row[5];
    // alpha is opacity·e^(−σ), so that ∂/∂opacity = −∂/∂σ / opacity; a culled splat has opacity and gradient 0.
    let opacity = opacities[splat];
    var g_opacity = 0.0;
    if (opacity > 0.0) {
        g_opacity = -row[0] / opacity;
    }
    g_opacities[splat] = g_opacity;
    for (var channel = 0u; channel < 3u; channel++) {
        g_colors[3u * splat + channel] = row[6u + channel];
    }
    if (DEPTH == 1u) {
        g_depths[splat] = row[8u + DEPTH];
    }
    for (var feature = 0u; feature < FEATURES; feature++) {
        g_features[splat * FEATURES + feature] = row[9u + DEPTH + feature];
    }
}
