// One element of the covariance factor of a row, [9] by rows.
#import rasteriser::projection::factors

fn value(row: u32, column: u32) -> f32 {
    let factor = factor_at(row);
    if (!factor.in_range) {
        // Infinity, which has no literal in WGSL: projection culls it, as it culls such scales.
        return bitcast<f32>(0x7f800000u | min(row, 0u));
    }
    let rows = array<vec3<f32>, 3>(factor.matrix.x, factor.matrix.y, factor.matrix.z);
    return rows[column / 3u][column % 3u];
}
