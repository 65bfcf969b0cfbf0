// The gradients of `align`.
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> dy: array<f32>

fn gradient_0(row: u32, column: u32) -> f32 {
    let reference = vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]);
    return select(1.0, -1.0, dot(quaternion_0(row), reference) < 0.0) * dy[4u * row + column];
}

// The reference only selects the sign, so it has no gradient.
fn gradient_1(row: u32, column: u32) -> f32 {
    return 0.0;
}
