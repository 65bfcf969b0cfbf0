// The gradients of the Hamilton product. Multiplication by q is linear; its transpose is multiplication by the
// conjugate.
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> dy: array<f32>

// The upstream gradient of a row.
fn arriving(row: u32) -> vec4<f32> {
    return vec4<f32>(dy[4u * row], dy[4u * row + 1u], dy[4u * row + 2u], dy[4u * row + 3u]);
}

fn gradient_0(row: u32, column: u32) -> f32 {
    let q = vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]);
    let gradient = hamilton(arriving(row), conjugate(q));
    return gradient[column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    let gradient = hamilton(conjugate(quaternion_0(row)), arriving(row));
    return gradient[column];
}
