// The number of tiles that each splat intersects, and its sort key: its depth, or NOWHERE if it intersects none. One
// invocation per splat.
#import gpu::elements
#import gpu::nowhere
#import rasteriser::binning::tile_spans

@group(0) @binding(4) var<storage, read> depths: array<f32>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;

fn run(splat: u32) {
    if (splat >= grid.count) {
        return;
    }
    var count = 0u;
    if (cutoffs[splat] >= 0.0) {
        let ellipse = ellipse_of(splat);
        let rows = rows_of(ellipse);
        for (var row = rows.first; row < rows.end; row++) {
            let columns = columns_of(ellipse, row);
            count += max(columns.end, columns.first) - columns.first;
        }
    }
    counts[splat] = count;
    // The bits of positive floats sort as their values do.
    keys[splat] = select(NOWHERE, bitcast<u32>(depths[splat]), count > 0u);
}
