// The gradient of q / |q|.
#import geometry::algebra
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> dy: array<f32>

fn gradient_0(row: u32, column: u32) -> f32 {
    let g = vec4<f32>(dy[4u * row], dy[4u * row + 1u], dy[4u * row + 2u], dy[4u * row + 3u]);
    let gradient = normalised_backward(normalised(quaternion_0(row)), g);
    return gradient[column];
}
