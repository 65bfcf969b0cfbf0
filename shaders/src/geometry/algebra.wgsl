// 3×3 matrices by rows and quaternions (w, x, y, z): the definitions of `algebra.rs`.
#import gpu::is_finite

// Quaternions with a smaller squared norm have no direction and count as the identity.
const MIN_SQUARED_NORM: f32 = 1e-12;

// A matrix by rows.
struct Rows {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

// A unit quaternion and 1/|q|. The inverse norm is zero if q has no direction.
struct Unit {
    quaternion: vec4<f32>,
    inverse_norm: f32,
}

fn is_finite3(v: vec3<f32>) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

// v·m for a row v.
fn row_times(v: vec3<f32>, m: Rows) -> vec3<f32> {
    return v.x * m.x + v.y * m.y + v.z * m.z;
}

// m·v for a column v.
fn apply(m: Rows, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(m.x, v), dot(m.y, v), dot(m.z, v));
}

// m·diag(s).
fn scale_columns(m: Rows, s: vec3<f32>) -> Rows {
    return Rows(m.x * s, m.y * s, m.z * s);
}

// 1 / (1 + e⁻ˣ) without overflow.
fn sigmoid(x: f32) -> f32 {
    let e = exp(-abs(x));
    return select(e, 1.0, x >= 0.0) / (1.0 + e);
}

fn normalised(q: vec4<f32>) -> Unit {
    let squared = dot(q, q);
    if (squared < MIN_SQUARED_NORM) {
        return Unit(vec4<f32>(1.0, 0.0, 0.0, 0.0), 0.0);
    }
    let inverse_norm = 1.0 / sqrt(squared);
    return Unit(q * inverse_norm, inverse_norm);
}

// The gradient with respect to q, given that of q/|q|: the component tangential to the unit sphere, times 1/|q|.
fn normalised_backward(unit: Unit, g: vec4<f32>) -> vec4<f32> {
    return (g - dot(g, unit.quaternion) * unit.quaternion) * unit.inverse_norm;
}

// The rotation of a unit quaternion.
fn rotation_matrix(q: vec4<f32>) -> Rows {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return Rows(
        vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        vec3<f32>(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        vec3<f32>(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

// The gradient with respect to the unit quaternion, given that of its rotation matrix, before the projection to the
// tangent space.
fn rotation_backward(q: vec4<f32>, g: Rows) -> vec4<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    let wx = g.z.y - g.y.z;
    let wy = g.x.z - g.z.x;
    let wz = g.y.x - g.x.y;
    let xy = g.x.y + g.y.x;
    let xz = g.x.z + g.z.x;
    let yz = g.y.z + g.z.y;
    return 2.0 * vec4<f32>(
        x * wx + y * wy + z * wz,
        y * xy + z * xz + w * wx - 2.0 * x * (g.y.y + g.z.z),
        x * xy + z * yz + w * wy - 2.0 * y * (g.x.x + g.z.z),
        x * xz + y * yz + w * wz - 2.0 * z * (g.x.x + g.y.y),
    );
}
