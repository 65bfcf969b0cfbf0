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

