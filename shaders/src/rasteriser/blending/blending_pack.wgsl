// Packs the splats front to back, those that intersect no tile last: per rank one record of three vectors, and depth
// and features. One invocation per rank.
#import gpu::flat_group
#const DEPTH

struct Pack {
    // Splats.
    count: u32,
    features: u32,
}

@group(0) @binding(0) var<uniform> sizes: Pack;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> means2d: array<f32>;
@group(0) @binding(3) var<storage, read> conics: array<f32>;
@group(0) @binding(4) var<storage, read> opacities: array<f32>;
@group(0) @binding(5) var<storage, read> colors: array<f32>;
@group(0) @binding(6) var<storage, read> cutoffs: array<f32>;
@group(0) @binding(7) var<storage, read> depths: array<f32>;
@group(0) @binding(8) var<storage, read> features: array<f32>;
@group(0) @binding(9) var<storage, read_write> records: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> extras: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = flat_group(group, groups) * 256u + local;
    if (rank >= sizes.count) {
        return;
    }
    let i = order[rank];
    let at = 3u * i;
    records[3u * rank] = vec4<f32>(means2d[2u * i], means2d[2u * i + 1u], conics[at], conics[at + 1u]);
    records[3u * rank + 1u] = vec4<f32>(conics[at + 2u], opacities[i], cutoffs[i], 0.0);
    records[3u * rank + 2u] = vec4<f32>(colors[at], colors[at + 1u], colors[at + 2u], 0.0);
    let first = rank * (DEPTH + sizes.features);
    if (DEPTH == 1u) {
        extras[first] = depths[i];
    }
    for (var feature = 0u; feature < sizes.features; feature++) {
        extras[first + DEPTH + feature] = features[i * sizes.features + feature];
    }
}
