// What one splat is to one pixel: the same definitions in both directions. EXTRAS is the number of channels beside the
// colours, the first of which is the depth if DEPTH is 1; SMOOTH is 1 where alpha fades to zero at its threshold.

struct Blend {
    width: u32,
    height: u32,
    // Tiles per row of tiles, tiles.
    columns: u32,
    tiles: u32,
    alpha_cap: f32,
    stop: f32,
    alpha_threshold: f32,
    padding: f32,
    background: vec4<f32>,
}

@group(0) @binding(0) var<uniform> blend: Blend;
// Three vectors per rank: mean, A, k; m, opacity, cutoff; colour.
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> extras: array<f32>;
@group(0) @binding(3) var<storage, read> ranks: array<u32>;
@group(0) @binding(4) var<storage, read> tile_starts: array<u32>;

const TILE: u32 = 16u;
const PIXELS: u32 = 256u;
const FEATURES: u32 = EXTRAS - DEPTH;

struct Sample {
    // Whether σ is at most the cutoff.
    is_seen: bool,
    e: f32,
    dy: f32,
    alpha: f32,
    // ∂alpha/∂σ.
    alpha_by_sigma: f32,
}

// The corner of a tile, and the pixel of an invocation in it.
fn corner_of(tile: u32) -> vec2<u32> {
    return TILE * vec2<u32>(tile % blend.columns, tile / blend.columns);
}

fn pixel_of(corner: vec2<u32>, local: u32) -> vec2<u32> {
    return corner + vec2<u32>(local % TILE, local / TILE);
}

fn is_in_image(pixel: vec2<u32>) -> bool {
    return pixel.x < blend.width && pixel.y < blend.height;
}

// e = dx + k·dy and dy, of mean − centre of the pixel.
fn offset_to(rank: u32, pixel: vec2<u32>) -> vec2<f32> {
    let record = records[3u * rank];
    let offset = record.xy - (vec2<f32>(pixel) + 0.5);
    return vec2<f32>(offset.x + record.w * offset.y, offset.y);
}

fn sample_of(rank: u32, pixel: vec2<u32>) -> Sample {
    var sample: Sample;
    let offset = offset_to(rank, pixel);
    sample.e = offset.x;
    sample.dy = offset.y;
    let shape = records[3u * rank + 1u];
    let sigma = 0.5 * (records[3u * rank].z * sample.e * sample.e + shape.x * sample.dy * sample.dy);
    sample.is_seen = sigma <= shape.z;
    if (!sample.is_seen) {
        return sample;
    }
    let uncapped = shape.y * exp(-sigma);
    var fade = 1.0;
    var fade_slope = 0.0;
    if (SMOOTH == 1u) {
        let t = min(max(uncapped / blend.alpha_threshold - 0.5, 0.0), 1.0);
        if (t < 1.0) {
            fade = t * t * (3.0 - 2.0 * t);
            fade_slope = 6.0 * t * (1.0 - t) / blend.alpha_threshold;
        }
    }
    let is_free = uncapped < blend.alpha_cap;
    let capped = min(uncapped, blend.alpha_cap);
    sample.alpha = capped * fade;
    sample.alpha_by_sigma = -uncapped * (select(0.0, fade, is_free) + capped * fade_slope);
    return sample;
}


// One tile per workgroup: a row of sums over its pixels for every entry, Σ v·(1, e, e², e·dy, dy, dy²) with v the gradient
// of σ, then the gradients of the channels. Front to back with one scalar per pixel, Σ wφ over what is still to come.
//
// In rounds of CHUNK entries each invocation first is a pixel and leaves (v, weight) of every entry; then it is a quarter of
// a row of pixels for one entry; then the parts are added in a fixed order. ARRIVING tells by bits which of the gradients of
// colour, alpha, depth and features there are; what stands in for another is not read.

@group(0) @binding(5) var<storage, read> transmittances: array<f32>;
@group(0) @binding(6) var<storage, read> last_entries: array<u32>;
@group(0) @binding(7) var<storage, read> color: array<f32>;
@group(0) @binding(8) var<storage, read> depth: array<f32>;
@group(0) @binding(9) var<storage, read> features: array<f32>;
@group(0) @binding(10) var<storage, read> g_color: array<f32>;
@group(0) @binding(11) var<storage, read> g_alpha: array<f32>;
@group(0) @binding(12) var<storage, read> g_depth: array<f32>;
@group(0) @binding(13) var<storage, read> g_features: array<f32>;
@group(0) @binding(14) var<storage, read_write> rows: array<f32>;

const CHUNK: u32 = 4u;
// Parts of an entry's sums, and the pixels of each.
const PARTS: u32 = 64u;
const PART_PIXELS: u32 = 4u;
const MOMENTS: u32 = 6u;
const CHANNELS: u32 = 3u + EXTRAS;
const ROW: u32 = MOMENTS + CHANNELS;

// [entry of the round, pixel]: gradient of σ, and weight.
var<workgroup> samples: array<vec2<f32>, 1024>;
// [column, entry of the round, part].
var<workgroup> parts: array<f32, 1536>;
var<workgroup> tile_last: atomic<u32>;

fn place(pixel: vec2<u32>) -> u32 {
    return pixel.y * blend.width + pixel.x;
}

// The gradient that arrives at a channel of a pixel: three colours, depth, features.
fn channel_gradient(at: u32, channel: u32) -> f32 {
    if (channel < 3u) {
        if ((ARRIVING & 1u) != 0u) {
            return g_color[3u * at + channel];
        }
    } else if (DEPTH == 1u && channel == 3u) {
        if ((ARRIVING & 4u) != 0u) {
            return g_depth[at];
        }
    } else if ((ARRIVING & 8u) != 0u) {
        return g_features[at * FEATURES + channel - 3u - DEPTH];
    }
    return 0.0;
}

fn channel_value(at: u32, channel: u32) -> f32 {
    if (channel < 3u) {
        return color[3u * at + channel];
    } else if (DEPTH == 1u && channel == 3u) {
        return depth[at];
    }
    return features[at * FEATURES + channel - 3u - DEPTH];
}

// Σ value·gradient over the channels of the image, the share of what lies behind everything included.
fn gradient_in_total(at: u32) -> f32 {
    var total = 0.0;
    for (var channel = 0u; channel < CHANNELS; channel++) {
        total += channel_gradient(at, channel) * channel_value(at, channel);
    }
    if ((ARRIVING & 2u) != 0u) {
        total -= g_alpha[at] * transmittances[at];
    }
    return total;
}

// φ = Σ value·gradient over the channels of a splat.
fn phi_of(rank: u32, at: u32) -> f32 {
    let own = records[3u * rank + 2u].xyz;
    var phi = 0.0;
    for (var channel = 0u; channel < 3u; channel++) {
        phi += own[channel] * channel_gradient(at, channel);
    }
    for (var channel = 0u; channel < EXTRAS; channel++) {
        phi += extras[rank * EXTRAS + channel] * channel_gradient(at, 3u + channel);
    }
    return phi;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = flat_group(group, groups);
    let is_tile = tile < blend.tiles;
    let corner = corner_of(tile);
    let pixel = pixel_of(corner, local);
    let is_pixel = is_tile && is_in_image(pixel);
    var start = 0u;
    var end = 0u;
    if (is_tile) {
        start = tile_starts[tile];
        end = tile_starts[tile + 1u];
    }
    var last = 0u;
    var transmittance = 1.0;
    var remaining = 0.0;
    let at = place(pixel);
    if (is_pixel) {
        last = last_entries[at];
        remaining = gradient_in_total(at);
    }
    if (local == 0u) {
        atomicStore(&tile_last, 0u);
    }
    workgroupBarrier();
    // A maximum of whole numbers: its order does not matter.
    atomicMax(&tile_last, last);
    workgroupBarrier();
    let blended_end = workgroupUniformLoad(&tile_last);

    let entry_in_round = local / PARTS;
    let first_pixel = (local % PARTS) * PART_PIXELS;
    for (var round = 0u; round < blended_end; round += CHUNK) {
        // The pixels.
        for (var k = 0u; k < CHUNK; k++) {
            var left = vec2<f32>(0.0);
            if (round + k < last) {
                let rank = ranks[start + round + k];
                let sample = sample_of(rank, pixel);
                if (sample.is_seen) {
                    let weight = sample.alpha * transmittance;
                    let phi = phi_of(rank, at);
                    remaining -= weight * phi;
                    let g_alpha_here = transmittance * phi - remaining / (1.0 - sample.alpha);
                    left = vec2<f32>(g_alpha_here * sample.alpha_by_sigma, weight);
                    transmittance *= 1.0 - sample.alpha;
                }
            }
            samples[k * PIXELS + local] = left;
        }
        workgroupBarrier();

        let entry = start + round + entry_in_round;
        let is_entry = entry < end;
        // The moments of four pixels of one entry; zeros are written out, as naga does not renew what a loop declares.
        var moments = array<f32, 6>();
        if (is_entry) {
            let rank = ranks[entry];
            for (var i = 0u; i < PART_PIXELS; i++) {
                let v = samples[entry_in_round * PIXELS + first_pixel + i].x;
                let offset = offset_to(rank, pixel_of(corner, first_pixel + i));
                moments[0] += v;
                moments[1] += v * offset.x;
                moments[2] += v * offset.x * offset.x;
                moments[3] += v * offset.x * offset.y;
                moments[4] += v * offset.y;
                moments[5] += v * offset.y * offset.y;
            }
        }
        for (var column = 0u; column < MOMENTS; column++) {
            parts[column * PIXELS + local] = moments[column];
        }
        workgroupBarrier();
        add_parts(local, start + round, end, 0u);
        workgroupBarrier();

        // The channels, six at a time.
        for (var first = 0u; first < CHANNELS; first += MOMENTS) {
            for (var column = 0u; column < MOMENTS; column++) {
                var sum = 0.0;
                let channel = first + column;
                if (is_entry && channel < CHANNELS) {
                    for (var i = 0u; i < PART_PIXELS; i++) {
                        let other = pixel_of(corner, first_pixel + i);
                        let weight = samples[entry_in_round * PIXELS + first_pixel + i].y;
                        if (is_in_image(other)) {
                            sum += weight * channel_gradient(place(other), channel);
                        }
                    }
                }
                parts[column * PIXELS + local] = sum;
            }
            workgroupBarrier();
            add_parts(local, start + round, end, MOMENTS + first);
            workgroupBarrier();
        }
    }

    // Entries behind everything that was blended have no gradient.
    let done = (blended_end + CHUNK - 1u) / CHUNK * CHUNK;
    for (var at_row = (start + done) * ROW + local; at_row < end * ROW; at_row += PIXELS) {
        rows[at_row] = 0.0;
    }
}

// Adds the parts of every entry of a round, one column of one entry per invocation, in the order of the parts.
fn add_parts(local: u32, first_entry: u32, end: u32, first_column: u32) {
    let entry = local / MOMENTS;
    let column = local % MOMENTS;
    if (entry < CHUNK && first_entry + entry < end && first_column + column < ROW) {
        var sum = 0.0;
        for (var part = 0u; part < PARTS; part++) {
            sum += parts[column * PIXELS + entry * PARTS + part];
        }
        rows[(first_entry + entry) * ROW + first_column + column] = sum;
    }
}
