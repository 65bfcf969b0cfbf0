// The tiles that intersect the ellipse of a splat.
#import rasteriser::binning::ellipse

struct Grid {
    width: u32,
    height: u32,
    // Tiles per row of tiles, rows of tiles, tiles.
    columns: u32,
    rows: u32,
    tiles: u32,
    // Splats.
    count: u32,
    // Capacity of the list of hits, if hits are written.
    capacity: u32,
}

@group(0) @binding(0) var<uniform> grid: Grid;
@group(0) @binding(1) var<storage, read> means2d: array<f32>;
@group(0) @binding(2) var<storage, read> conics: array<f32>;
@group(0) @binding(3) var<storage, read> cutoffs: array<f32>;

const TILE: u32 = 16u;

// Tiles first..end along one axis; empty if first ≥ end.
struct Span {
    first: u32,
    end: u32,
}

fn ellipse_of(splat: u32) -> Ellipse {
    let center = vec2<f32>(means2d[2u * splat], means2d[2u * splat + 1u]);
    let conic = vec3<f32>(conics[3u * splat], conics[3u * splat + 1u], conics[3u * splat + 2u]);
    return ellipse_around(center, conic, cutoffs[splat]);
}

// The tiles along an axis of `size` pixels whose pixel centres span an interval that intersects [low, high].
fn tiles_between(low: f32, high: f32, size: u32) -> Span {
    let last_center = f32(size) - 0.5;
    if (!(high >= 0.5 && low <= last_center)) {
        return Span(0u, 0u);
    }
    // Clamped before the conversion to integers, because coordinates may have any value.
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

// The columns of those tiles of a row of tiles that intersect the ellipse between the row's first and last line of
// pixel centres.
fn columns_of(ellipse: Ellipse, row: u32) -> Span {
    let first = f32(row * TILE) + 0.5;
    let last = f32(min(row * TILE + TILE, grid.height) - 1u) + 0.5;
    let shadow = shadow_between(ellipse, first, last);
    return tiles_between(shadow.x, shadow.y, grid.width);
}
