// The Hamilton product of the quaternions of every row.
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x1: array<f32>

// A row of the second input.
fn quaternion_1(row: u32) -> vec4<f32> {
    return vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]);
}

fn value(row: u32, column: u32) -> f32 {
    let product = hamilton(quaternion_0(row), quaternion_1(row));
    return product[column];
}
