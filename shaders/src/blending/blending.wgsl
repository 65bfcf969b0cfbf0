// One tile per workgroup, one pixel per invocation: images, the transmittance after the last splat, and how many entries of
// the tile lie before the end of the last that was blended.

@group(0) @binding(5) var<storage, read_write> color: array<f32>;
@group(0) @binding(6) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> depth: array<f32>;
@group(0) @binding(8) var<storage, read_write> features: array<f32>;
@group(0) @binding(9) var<storage, read_write> transmittances: array<f32>;
@group(0) @binding(10) var<storage, read_write> last_entries: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = flat_group(group, groups);
    let pixel = pixel_of(corner_of(tile), local);
    if (tile >= blend.tiles || !is_in_image(pixel)) {
        return;
    }
    var transmittance = 1.0;
    var blended_color = vec3<f32>(0.0);
    var sums: array<f32, EXTRAS + 1u>;
    var last = 0u;
    let start = tile_starts[tile];
    let end = tile_starts[tile + 1u];
    for (var entry = start; entry < end; entry++) {
        let rank = ranks[entry];
        let sample = sample_of(rank, pixel);
        if (!sample.is_seen) {
            continue;
        }
        let next = transmittance * (1.0 - sample.alpha);
        if (next <= blend.stop) {
            break;
        }
        let weight = sample.alpha * transmittance;
        blended_color += weight * records[3u * rank + 2u].xyz;
        for (var channel = 0u; channel < EXTRAS; channel++) {
            sums[channel] += weight * extras[rank * EXTRAS + channel];
        }
        transmittance = next;
        last = entry + 1u - start;
    }

    let at = pixel.y * blend.width + pixel.x;
    blended_color += transmittance * blend.background.xyz;
    color[3u * at] = blended_color.x;
    color[3u * at + 1u] = blended_color.y;
    color[3u * at + 2u] = blended_color.z;
    alpha[at] = 1.0 - transmittance;
    if (DEPTH == 1u) {
        depth[at] = sums[0];
    }
    for (var feature = 0u; feature < FEATURES; feature++) {
        features[at * FEATURES + feature] = sums[DEPTH + feature];
    }
    transmittances[at] = transmittance;
    last_entries[at] = last;
}
