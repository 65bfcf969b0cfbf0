// The number of tiles that each splat intersects, and its sort key: its depth, or NOWHERE if it intersects none. One
// invocation per splat.

@group(0) @binding(4) var<storage, read> depths: array<f32>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let splat = flat_group(group, groups) * 256u + local;
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
