// The tiles that meet the ellipse σ ≤ cutoff: the same definitions as for the CPU.

struct Grid {
    width: u32,
    height: u32,
    // Tiles per row of tiles, rows of tiles, tiles.
    columns: u32,
    rows: u32,
    tiles: u32,
    // Splats.
    count: u32,
}

@group(0) @binding(0) var<uniform> grid: Grid;
@group(0) @binding(1) var<storage, read> means2d: array<f32>;
@group(0) @binding(2) var<storage, read> conics: array<f32>;
@group(0) @binding(3) var<storage, read> cutoffs: array<f32>;

const TILE: u32 = 16u;
// Relative and absolute growth of the cutoff, and of an interval relative to its coordinates.
const CUTOFF_SLACK: f32 = 1e-4;
const COORDINATE_SLACK: f32 = 1e-6;

struct Ellipse {
    center: vec2<f32>,
    // A, k, m.
    conic: vec3<f32>,
    // 2·cutoff.
    squared_radius: f32,
    half_extents: vec2<f32>,
    // Height above the centre of the rightmost point.
    tip_offset: f32,
}

// Tiles first..end along one axis; none if first ≥ end.
struct Span {
    first: u32,
    end: u32,
}

fn ellipse_of(splat: u32) -> Ellipse {
    var ellipse: Ellipse;
    ellipse.center = vec2<f32>(means2d[2u * splat], means2d[2u * splat + 1u]);
    ellipse.conic = vec3<f32>(conics[3u * splat], conics[3u * splat + 1u], conics[3u * splat + 2u]);
    let cutoff = cutoffs[splat];
    ellipse.squared_radius = 2.0 * (cutoff + cutoff * CUTOFF_SLACK + CUTOFF_SLACK);
    // The covariance from the conic: var y = 1/m, var x = 1/A + k²/m, cov = −k/m.
    let k = ellipse.conic.y;
    let variance_y = 1.0 / ellipse.conic.z;
    let variance_x = 1.0 / ellipse.conic.x + k * k / ellipse.conic.z;
    ellipse.half_extents = sqrt(ellipse.squared_radius * vec2<f32>(variance_x, variance_y));
    ellipse.tip_offset = -k * variance_y / variance_x * ellipse.half_extents.x;
    return ellipse;
}

// The tiles along an axis of `size` pixels with a span of pixel centres that meets [low, high].
fn tiles_between(low: f32, high: f32, size: u32) -> Span {
    let last_center = f32(size) - 0.5;
    if (!(high >= 0.5 && low <= last_center)) {
        return Span(0u, 0u);
    }
    // Clamped as floats before they become integers: coordinates may be anything.
    let start = max(low, 0.0);
    let containing_low = u32(start / f32(TILE));
    let is_past_its_centers = start > f32(containing_low * TILE + TILE) - 0.5;
    let containing_high = u32((min(high, last_center) - 0.5) / f32(TILE));
    return Span(containing_low + select(0u, 1u, is_past_its_centers), containing_high + 1u);
}

fn rows_of(ellipse: Ellipse) -> Span {
    let slack = COORDINATE_SLACK * (abs(ellipse.center.y) + ellipse.half_extents.y);
    let low = ellipse.center.y - ellipse.half_extents.y - slack;
    return tiles_between(low, ellipse.center.y + ellipse.half_extents.y + slack, grid.height);
}

// Half the width at a height relative to the centre.
fn half_width(ellipse: Ellipse, offset_y: f32) -> f32 {
    let room = max(ellipse.squared_radius - ellipse.conic.z * offset_y * offset_y, 0.0);
    return sqrt(room / ellipse.conic.x);
}

// The columns of the tiles in a row of tiles that meet the ellipse: its part between the first and the last line of pixel
// centres is convex, so that its shadow decides, which ends at the tips or, where they lie outside, at the nearer line.
fn columns_of(ellipse: Ellipse, row: u32) -> Span {
    let first = f32(row * TILE) + 0.5;
    let last = f32(min(row * TILE + TILE, grid.height) - 1u) + 0.5;
    let lowest = max(first - ellipse.center.y, -ellipse.half_extents.y);
    let highest = min(last - ellipse.center.y, ellipse.half_extents.y);
    if (!(lowest <= highest)) {
        return Span(0u, 0u);
    }
    let k = ellipse.conic.y;
    let at_right = min(max(ellipse.tip_offset, lowest), highest);
    let at_left = min(max(-ellipse.tip_offset, lowest), highest);
    let right = -k * at_right + half_width(ellipse, at_right);
    let left = -k * at_left - half_width(ellipse, at_left);
    let slack = COORDINATE_SLACK * (abs(ellipse.center.x) + ellipse.half_extents.x);
    return tiles_between(ellipse.center.x + left - slack, ellipse.center.x + right + slack, grid.width);
}

