// The gradients of a rotation of vectors.
#import geometry::algebra
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> dy: array<f32>

// The upstream gradient of a row.
fn arriving(row: u32) -> vec3<f32> {
    return vec3<f32>(dy[3u * row], dy[3u * row + 1u], dy[3u * row + 2u]);
}

// The rotated vector is v + 2w(u×v) + 2(u(u·v) − v(u·u)) for the unit quaternion (w, u).
fn gradient_0(row: u32, column: u32) -> f32 {
    let unit = normalised(quaternion_0(row));
    let w = unit.quaternion.x;
    let u = unit.quaternion.yzw;
    let v = vec3<f32>(x1[3u * row], x1[3u * row + 1u], x1[3u * row + 2u]);
    let g = arriving(row);
    let of_u = 2.0 * (w * cross(v, g) + dot(u, v) * g + dot(u, g) * v - 2.0 * dot(v, g) * u);
    let gradient = normalised_backward(unit, vec4<f32>(2.0 * dot(cross(u, v), g), of_u));
    return gradient[column];
}

// The upstream gradient, rotated by the inverse.
fn gradient_1(row: u32, column: u32) -> f32 {
    let q = normalised(quaternion_0(row)).quaternion;
    let g = arriving(row);
    let turned = g + 2.0 * (cross(q.yzw, cross(q.yzw, g)) - q.x * cross(q.yzw, g));
    return turned[column];
}
