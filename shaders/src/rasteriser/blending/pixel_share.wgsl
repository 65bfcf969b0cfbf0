// A pixel's contribution to the gradient of an entry of its tile. The pixel visits the entries front to back and
// carries one scalar: Σ wφ over the remaining entries. The row of an entry holds the sums over all pixels of v·(1, e,
// e², e·dy, dy, dy²), with v the gradient of σ, then of the weight times the gradient of each channel. ARRIVING is a
// bit mask of the upstream gradients that exist: colour, alpha, depth, features. The placeholder for a missing one is
// never read.
#import rasteriser::blending::splat_at_pixel
#const ARRIVING, DEPTH, EXTRAS
#extern var<private> colors: array<vec4<f32>, 1>
#extern fn extra_value(entry: u32, extra: u32) -> f32

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

const MOMENTS: u32 = 6u;
const CHANNELS: u32 = 3u + EXTRAS;
const ROW: u32 = MOMENTS + CHANNELS;
// Vectors that hold the channels after the first two.
const TAILS: u32 = (CHANNELS + 1u) / 4u;

struct Pixel {
    center: vec2<f32>,
    // Entries of the tile up to the last that was blended.
    last: u32,
    transmittance: f32,
    remaining: f32,
    // Upstream gradients of the channels: the first two, then the others.
    head: vec2<f32>,
    tails: array<vec4<f32>, TAILS>,
}

// The contribution of one pixel to one entry.
struct Share {
    // The gradient of σ.
    v: f32,
    weight: f32,
}

// The values that a share adds to the columns of a row, in the order of the columns.
struct Row {
    first: vec4<f32>,
    second: vec4<f32>,
    tails: array<vec4<f32>, TAILS>,
}

var<workgroup> tile_last: atomic<u32>;

// The upstream gradient of a channel of a pixel: three colours, depth, features; 0 past the last.
fn channel_gradient(at: u32, channel: u32) -> f32 {
    if (channel < 3u) {
        if ((ARRIVING & 1u) != 0u) {
            return g_color[3u * at + channel];
        }
    } else if (DEPTH == 1u && channel == 3u) {
        if ((ARRIVING & 4u) != 0u) {
            return g_depth[at];
        }
    } else if ((ARRIVING & 8u) != 0u && channel < CHANNELS) {
        return g_features[at * FEATURES + channel - 3u - DEPTH];
    }
    return 0.0;
}

fn channel_gradients(at: u32, first: u32) -> vec4<f32> {
    return vec4<f32>(
        channel_gradient(at, first),
        channel_gradient(at, first + 1u),
        channel_gradient(at, first + 2u),
        channel_gradient(at, first + 3u),
    );
}

fn channel_value(at: u32, channel: u32) -> f32 {
    if (channel < 3u) {
        return color[3u * at + channel];
    } else if (DEPTH == 1u && channel == 3u) {
        return depth[at];
    }
    return features[at * FEATURES + channel - 3u - DEPTH];
}

// Σ value·gradient over the channels of the image, including the background's share.
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

// The state of a pixel before the first entry; outside the image it blends nothing.
fn pixel_before(position: vec2<u32>) -> Pixel {
    var pixel: Pixel;
    pixel.center = center_of(position);
    pixel.transmittance = 1.0;
    if (is_in_image(position)) {
        let at = position.y * blend.width + position.x;
        pixel.last = last_entries[at];
        pixel.remaining = gradient_in_total(at);
        pixel.head = channel_gradients(at, 0u).xy;
        for (var tail = 0u; tail < TAILS; tail++) {
            pixel.tails[tail] = channel_gradients(at, 2u + 4u * tail);
        }
    }
    return pixel;
}

// The maximum of the pixels' last entries.
fn last_of_tile(local: u32, last: u32) -> u32 {
    if (local == 0u) {
        atomicStore(&tile_last, 0u);
    }
    workgroupBarrier();
    // An integer maximum does not depend on the order.
    atomicMax(&tile_last, last);
    return workgroupUniformLoad(&tile_last);
}

// The channel values of an entry that correspond to the gradients of a tail.
fn tail_values(entry: u32, tail: u32) -> vec4<f32> {
    if (tail == 0u) {
        return vec4<f32>(colors[entry].z, extra_value(entry, 0u), extra_value(entry, 1u), extra_value(entry, 2u));
    }
    let first = 4u * tail - 1u;
    return vec4<f32>(
        extra_value(entry, first),
        extra_value(entry, first + 1u),
        extra_value(entry, first + 2u),
        extra_value(entry, first + 3u),
    );
}

// Advances a pixel past an entry, without branches, so that a subgroup does not diverge. An entry that is not blended
// does not affect the pixel, even if its values are NaN.
fn pass_entry(pixel: ptr<function, Pixel>, entry: u32, sigma: f32, is_blended: bool) -> Share {
    let opacity = opacity_of(entry, sigma);
    let transmittance = (*pixel).transmittance;
    // φ = Σ value·gradient over the channels of the entry.
    var phi = dot(colors[entry].xy, (*pixel).head) + dot(tail_values(entry, 0u), (*pixel).tails[0]);
    for (var tail = 1u; tail < TAILS; tail++) {
        phi += dot(tail_values(entry, tail), (*pixel).tails[tail]);
    }
    let weight = opacity.alpha * transmittance;
    let remaining = (*pixel).remaining - weight * phi;
    let g_alpha_here = transmittance * phi - remaining / (1.0 - opacity.alpha);
    (*pixel).remaining = select((*pixel).remaining, remaining, is_blended);
    (*pixel).transmittance = select(transmittance, transmittance * (1.0 - opacity.alpha), is_blended);
    return Share(select(0.0, g_alpha_here * opacity.alpha_by_sigma, is_blended), select(0.0, weight, is_blended));
}

fn row_of(pixel: ptr<function, Pixel>, share: Share, offset: vec2<f32>) -> Row {
    var row: Row;
    let by_e = share.v * offset.x;
    let by_dy = share.v * offset.y;
    row.first = vec4<f32>(share.v, by_e, by_e * offset.x, by_e * offset.y);
    row.second = vec4<f32>(by_dy, by_dy * offset.y, share.weight * (*pixel).head);
    for (var tail = 0u; tail < TAILS; tail++) {
        row.tails[tail] = share.weight * (*pixel).tails[tail];
    }
    return row;
}

// Zeroes the rows of the entries after the last blended one, which have no gradient.
fn clear_rows(local: u32, first: u32, end: u32) {
    for (var at = first * ROW + local; at < end * ROW; at += PIXELS) {
        rows[at] = 0.0;
    }
}
