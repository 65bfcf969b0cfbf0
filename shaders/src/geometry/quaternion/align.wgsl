// q or −q of every row, whichever is on the side of the reference.
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>

// −1 if q points away from the reference, otherwise 1.
fn side(row: u32) -> f32 {
    let reference = vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]);
    return select(1.0, -1.0, dot(quaternion_0(row), reference) < 0.0);
}

fn value(row: u32, column: u32) -> f32 {
    return side(row) * x0[4u * row + column];
}
