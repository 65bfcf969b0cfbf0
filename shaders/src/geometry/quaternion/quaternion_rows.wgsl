// Quaternions (w, x, y, z) of rows.
#extern var<storage, read> x0: array<f32>

fn hamilton(p: vec4<f32>, q: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(p.x * q.x - dot(p.yzw, q.yzw), p.x * q.yzw + q.x * p.yzw + cross(p.yzw, q.yzw));
}

fn conjugate(q: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(q.x, -q.yzw);
}

// A row of the first input.
fn quaternion_0(row: u32) -> vec4<f32> {
    return vec4<f32>(x0[4u * row], x0[4u * row + 1u], x0[4u * row + 2u], x0[4u * row + 3u]);
}
