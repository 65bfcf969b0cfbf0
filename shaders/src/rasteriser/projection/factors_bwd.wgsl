// The gradients of rows of logarithmic scales and quaternions, from those of their covariance factors.
#import geometry::algebra
#import rasteriser::projection::covariance_factor
#import rasteriser::projection::factors
#extern var<storage, read> dy: array<f32>

// Zero if the factor is out of range.
fn shape_gradient(row: u32) -> ShapeGradient {
    let factor = factor_at(row);
    if (!factor.in_range) {
        return ShapeGradient(vec3<f32>(0.0), vec4<f32>(0.0));
    }
    let at = 9u * row;
    let g = Rows(
        vec3<f32>(dy[at], dy[at + 1u], dy[at + 2u]),
        vec3<f32>(dy[at + 3u], dy[at + 4u], dy[at + 5u]),
        vec3<f32>(dy[at + 6u], dy[at + 7u], dy[at + 8u]),
    );
    return scaled_rotation_backward(factor, g);
}

fn gradient_0(row: u32, column: u32) -> f32 {
    return shape_gradient(row).log_scales[column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    return shape_gradient(row).rotation[column];
}
