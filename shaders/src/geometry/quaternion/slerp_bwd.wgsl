// The gradients of spherical linear interpolation.
#import geometry::algebra
#import geometry::quaternion::slerp_arc
#extern var<storage, read> dy: array<f32>

// The gradient of the weighted sum of both ends.
fn sum_gradient(arc: Arc, row: u32) -> vec4<f32> {
    let g = vec4<f32>(dy[4u * row], dy[4u * row + 1u], dy[4u * row + 2u], dy[4u * row + 3u]);
    return normalised_backward(between(arc), g);
}

// The components of the sum's gradient along both ends.
fn along(arc: Arc, of_sum: vec4<f32>) -> vec2<f32> {
    return vec2<f32>(dot(of_sum, arc.a.quaternion), dot(of_sum, arc.b.quaternion));
}

fn gradient_0(row: u32, column: u32) -> f32 {
    let arc = arc_of(row);
    let of_sum = sum_gradient(arc, row);
    let of_cosine = dot(along(arc, of_sum), arc.by_cosine);
    let gradient = normalised_backward(arc.a, arc.weights.x * of_sum + of_cosine * arc.b.quaternion);
    return gradient[column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    let arc = arc_of(row);
    let of_sum = sum_gradient(arc, row);
    let of_cosine = dot(along(arc, of_sum), arc.by_cosine);
    let gradient = normalised_backward(arc.b, arc.weights.y * of_sum + of_cosine * arc.a.quaternion);
    return arc.sign * gradient[column];
}

fn gradient_2(row: u32, column: u32) -> f32 {
    let arc = arc_of(row);
    return dot(along(arc, sum_gradient(arc, row)), arc.by_t);
}
