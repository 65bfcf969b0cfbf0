// The vectors of every row, rotated by the unit quaternion (w, u): v + 2w(u×v) + 2u×(u×v).
#import geometry::algebra
#import geometry::quaternion::quaternion_rows
#extern var<storage, read> x1: array<f32>

fn value(row: u32, column: u32) -> f32 {
    let q = normalised(quaternion_0(row)).quaternion;
    let v = vec3<f32>(x1[3u * row], x1[3u * row + 1u], x1[3u * row + 2u]);
    let turned = v + 2.0 * (q.x * cross(q.yzw, v) + cross(q.yzw, cross(q.yzw, v)));
    return turned[column];
}
