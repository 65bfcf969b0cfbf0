// Evaluates one splat at one pixel, for both directions. EXTRAS is the number of channels besides the colours; the
// first of them is the depth if DEPTH is 1. If SMOOTH is 1, alpha fades to zero at its threshold.
#const DEPTH, EXTRAS, SMOOTH
#extern var<private> places: array<vec4<f32>, 1>
#extern var<private> shapes: array<vec4<f32>, 1>

struct Blend {
    background: vec3<f32>,
    alpha_cap: f32,
    width: u32,
    height: u32,
    // Tiles per row of tiles, tiles.
    columns: u32,
    tiles: u32,
    stop: f32,
    alpha_threshold: f32,
    padding: vec2<u32>,
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
// The cells of a tile, two to a row. A cell has the pixels of 32 invocations, which hardware often runs together.
const CELLS: u32 = 8u;
const CELL_WIDTH: u32 = 8u;
const CELL_HEIGHT: u32 = 4u;
const CELL_PIXELS: u32 = 32u;

struct Opacity {
    alpha: f32,
    // ∂alpha/∂σ.
    alpha_by_sigma: f32,
}

// The first pixel of a tile.
fn corner_of(tile: u32) -> vec2<u32> {
    return TILE * vec2<u32>(tile % blend.columns, tile / blend.columns);
}

// The pixel at a place of a tile. Places are numbered cell by cell, and row by row within a cell.
fn pixel_of(corner: vec2<u32>, place: u32) -> vec2<u32> {
    let cell = place / CELL_PIXELS;
    let inner = place % CELL_PIXELS;
    let cell_corner = vec2<u32>(cell % 2u * CELL_WIDTH, cell / 2u * CELL_HEIGHT);
    return corner + cell_corner + vec2<u32>(inner % CELL_WIDTH, inner / CELL_WIDTH);
}

fn is_in_image(pixel: vec2<u32>) -> bool {
    return pixel.x < blend.width && pixel.y < blend.height;
}

fn center_of(pixel: vec2<u32>) -> vec2<f32> {
    return vec2<f32>(pixel) + 0.5;
}

// (e, dy) with e = dx + k·dy, for an entry of the batch and (dx, dy) = mean − pixel centre.
fn offset_to(entry: u32, center: vec2<f32>) -> vec2<f32> {
    let place = places[entry];
    let offset = place.xy - center;
    return vec2<f32>(offset.x + place.w * offset.y, offset.y);
}

fn sigma_of(entry: u32, offset: vec2<f32>) -> f32 {
    return 0.5 * (places[entry].z * offset.x * offset.x + shapes[entry].x * offset.y * offset.y);
}

fn is_seen(entry: u32, sigma: f32) -> bool {
    return sigma <= shapes[entry].z;
}

fn opacity_of(entry: u32, sigma: f32) -> Opacity {
    let uncapped = shapes[entry].y * exp(-sigma);
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
    return Opacity(capped * fade, -uncapped * (select(0.0, fade, is_free) + capped * fade_slope));
}
