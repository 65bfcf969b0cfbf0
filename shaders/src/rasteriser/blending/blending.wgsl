// Forward blending: the images, the final transmittance, and per pixel the index after the last blended entry of its
// tile. One workgroup per tile, one invocation per pixel.
#import gpu::flat_group
#import rasteriser::blending::splat_at_pixel
#import rasteriser::blending::staged_entries
#const BATCH, DEPTH, EXTRAS

@group(0) @binding(5) var<storage, read_write> color: array<f32>;
@group(0) @binding(6) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> depth: array<f32>;
@group(0) @binding(8) var<storage, read_write> features: array<f32>;
@group(0) @binding(9) var<storage, read_write> transmittances: array<f32>;
@group(0) @binding(10) var<storage, read_write> last_entries: array<u32>;

struct Pixel {
    transmittance: f32,
    color: vec3<f32>,
    extras: array<f32, EXTRAS + 1u>,
    last: u32,
    is_done: bool,
}

// Whether any pixel of the tile still blends.
var<workgroup> unfinished: atomic<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = flat_group(group, groups);
    if (tile >= blend.tiles) {
        return;
    }
    let corner = corner_of(tile);
    let place = pixel_of(corner, local);
    var pixel: Pixel;
    pixel.transmittance = 1.0;
    pixel.is_done = !is_in_image(place);

    let start = tile_starts[tile];
    let end = tile_starts[tile + 1u];
    clear_meetings(local);
    workgroupBarrier();
    var turn = 0u;
    for (var first = start; first < end; first += BATCH) {
        let count = min(end - first, BATCH);
        stage(local, turn, first, count, corner);
        if (local == 0u) {
            atomicStore(&unfinished, 0u);
        }
        workgroupBarrier();
        blend_batch(&pixel, place, local / CELL_PIXELS, turn, first - start);
        if (!pixel.is_done) {
            atomicStore(&unfinished, 1u);
        }
        turn = 1u - turn;
        if (workgroupUniformLoad(&unfinished) == 0u) {
            break;
        }
    }
    if (is_in_image(place)) {
        write(&pixel, place.y * blend.width + place.x);
    }
}

// Blends the entries of a batch that intersect the pixel's cell; `before` is the number of the tile's entries before
// the batch.
fn blend_batch(pixel: ptr<function, Pixel>, place: vec2<u32>, cell: u32, turn: u32, before: u32) {
    for (var word = 0u; word < WORDS && !(*pixel).is_done; word++) {
        var bits = meeting(turn, cell, word);
        while (bits != 0u) {
            let entry = 32u * word + firstTrailingBit(bits);
            bits &= bits - 1u;
            let sigma = sigma_of(entry, offset_to(entry, center_of(place)));
            if (!is_seen(entry, sigma)) {
                continue;
            }
            let alpha = opacity_of(entry, sigma).alpha;
            let next = (*pixel).transmittance * (1.0 - alpha);
            if (next <= blend.stop) {
                (*pixel).is_done = true;
                break;
            }
            let weight = alpha * (*pixel).transmittance;
            (*pixel).color += weight * colors[entry].xyz;
            for (var channel = 0u; channel < EXTRAS; channel++) {
                (*pixel).extras[channel] += weight * extra_value(entry, channel);
            }
            (*pixel).transmittance = next;
            (*pixel).last = before + entry + 1u;
        }
    }
}

fn write(pixel: ptr<function, Pixel>, at: u32) {
    let transmittance = (*pixel).transmittance;
    let blended = (*pixel).color + transmittance * blend.background;
    color[3u * at] = blended.x;
    color[3u * at + 1u] = blended.y;
    color[3u * at + 2u] = blended.z;
    alpha[at] = 1.0 - transmittance;
    if (DEPTH == 1u) {
        depth[at] = (*pixel).extras[0];
    }
    for (var feature = 0u; feature < FEATURES; feature++) {
        features[at * FEATURES + feature] = (*pixel).extras[DEPTH + feature];
    }
    transmittances[at] = transmittance;
    last_entries[at] = (*pixel).last;
}
