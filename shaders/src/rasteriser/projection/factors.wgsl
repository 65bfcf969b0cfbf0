// The covariance factors of rows of logarithmic scales (x0) and quaternions (x1).
#import rasteriser::projection::covariance_factor
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>

fn factor_at(row: u32) -> Factor {
    let log_scales = vec3<f32>(x0[3u * row], x0[3u * row + 1u], x0[3u * row + 2u]);
    let rotation = vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]);
    return scaled_rotation(log_scales, rotation);
}
