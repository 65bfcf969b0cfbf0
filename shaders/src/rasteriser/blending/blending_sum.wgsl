// The gradients of every splat: sums its rows in the order of its hits, then converts the moments to gradients of
// means, conics and opacities. LANES invocations share a splat; each sums one column at a time.
#import gpu::flat_group
#import gpu::nowhere
#const DEPTH, EXTRAS, LANES

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

const MOMENTS: u32 = 6u;
const ROW: u32 = 9u + EXTRAS;
const FEATURES: u32 = EXTRAS - DEPTH;
// Splats per workgroup.
const SPLATS: u32 = 256u / LANES;

var<workgroup> moments: array<f32, SPLATS * MOMENTS>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = local / LANES;
    let lane = local % LANES;
    let splat = flat_group(group, groups) * SPLATS + slot;
    let is_splat = slot < SPLATS && splat < sizes.count;
    for (var column = lane; is_splat && column < ROW; column += LANES) {
        let total = total_of(splat, column);
        if (column < MOMENTS) {
            moments[slot * MOMENTS + column] = total;
        } else {
            write_channel(splat, column - MOMENTS, total);
        }
    }
    workgroupBarrier();
    if (is_splat) {
        write_geometry(splat, lane, slot * MOMENTS);
    }
}

fn total_of(splat: u32, column: u32) -> f32 {
    var total = 0.0;
    let rank = rank_of_splat[splat];
    if (rank == NOWHERE) {
        return total;
    }
    var hit = hit_starts[rank];
    // The starts go beyond the capacity if hits were lost, until the rollback.
    let end = min(hit_starts[rank + 1u], arrayLength(&entry_of_hit));
    // Four independent reads at a time hide latency.
    for (; hit + 4u <= end; hit += 4u) {
        let values = vec4<f32>(
            value_of(hit, column),
            value_of(hit + 1u, column),
            value_of(hit + 2u, column),
            value_of(hit + 3u, column),
        );
        total = (((total + values.x) + values.y) + values.z) + values.w;
    }
    for (; hit < end; hit++) {
        total += value_of(hit, column);
    }
    return total;
}

// 0 for a hit that was counted but not found.
fn value_of(hit: u32, column: u32) -> f32 {
    let entry = entry_of_hit[hit];
    let is_found = entry != NOWHERE;
    return select(0.0, rows[select(0u, entry, is_found) * ROW + column], is_found);
}

// Writes one of six gradients, by the chain rule through e = dx + k·dy and σ = ½(A·e² + m·dy²).
fn write_geometry(splat: u32, which: u32, first: u32) {
    let a = conics[3u * splat];
    let k = conics[3u * splat + 1u];
    let m = conics[3u * splat + 2u];
    switch (which) {
        case 0u: {
            g_means2d[2u * splat] = a * moments[first + 1u];
        }
        case 1u: {
            g_means2d[2u * splat + 1u] = a * k * moments[first + 1u] + m * moments[first + 4u];
        }
        case 2u: {
            g_conics[3u * splat] = 0.5 * moments[first + 2u];
        }
        case 3u: {
            g_conics[3u * splat + 1u] = a * moments[first + 3u];
        }
        case 4u: {
            g_conics[3u * splat + 2u] = 0.5 * moments[first + 5u];
        }
        case 5u: {
            // alpha = opacity·e^(−σ), so ∂/∂opacity = −∂/∂σ / opacity. A culled splat has opacity and gradient 0.
            let opacity = opacities[splat];
            g_opacities[splat] = select(0.0, -moments[first] / opacity, opacity > 0.0);
        }
        default: {}
    }
}

fn write_channel(splat: u32, channel: u32, total: f32) {
    if (channel < 3u) {
        g_colors[3u * splat + channel] = total;
    } else if (DEPTH == 1u && channel == 3u) {
        g_depths[splat] = total;
    } else {
        g_features[splat * FEATURES + channel - 3u - DEPTH] = total;
    }
}
