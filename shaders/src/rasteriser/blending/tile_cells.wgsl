// The cells of a tile that an entry intersects, by the same test as for tiles: the ellipse σ ≤ cutoff, enlarged by more
// than the rounding error. So no pixel sees a splat that its cell does not intersect. If CULLED is 0, every entry
// counts as intersecting every cell.
#import rasteriser::binning::ellipse
#import rasteriser::blending::splat_at_pixel
#const CULLED

// Bit mask of the cells of a tile that intersect an entry, from the first two vectors of its record.
fn cells_meeting(place: vec4<f32>, shape: vec4<f32>, corner: vec2<u32>) -> u32 {
    if (CULLED == 0u) {
        return (1u << CELLS) - 1u;
    }
    let ellipse = ellipse_around(place.xy, vec3<f32>(place.zw, shape.x), shape.z);
    var cells = 0u;
    let left = f32(corner.x) + 0.5;
    for (var row = 0u; row < CELLS / 2u; row++) {
        let top = f32(corner.y + row * CELL_HEIGHT) + 0.5;
        let shadow = shadow_between(ellipse, top, top + f32(CELL_HEIGHT - 1u));
        for (var column = 0u; column < 2u; column++) {
            let first = left + f32(column * CELL_WIDTH);
            // NaN counts as intersecting.
            if (!(shadow.y < first) && !(shadow.x > first + f32(CELL_WIDTH - 1u))) {
                cells |= 1u << (2u * row + column);
            }
        }
    }
    return cells;
}
