// The factor F = R_q·diag(eˢ) of a splat's covariance FFᵀ, for both directions: the same definitions as on the CPU.
#import geometry::algebra

// Larger standard deviations are out of range, because they are about to overflow.
const MAX_SCALE: f32 = 1e9;

// F, and the intermediate values that its backward pass needs.
struct Factor {
    in_range: bool,
    matrix: Rows,
    unit: Unit,
    // Standard deviations.
    scales: vec3<f32>,
    rotation: Rows,
}

struct ShapeGradient {
    log_scales: vec3<f32>,
    rotation: vec4<f32>,
}

fn scaled_rotation(log_scales: vec3<f32>, raw_rotation: vec4<f32>) -> Factor {
    var factor: Factor;
    factor.scales = exp(log_scales);
    // A logarithm of minus infinity is a scale of zero. NaN is out of range.
    let is_number = is_finite3(factor.scales) && all(log_scales < vec3<f32>(3e38));
    factor.in_range = is_number && all(factor.scales <= vec3<f32>(MAX_SCALE));
    factor.unit = normalised(raw_rotation);
    factor.rotation = rotation_matrix(factor.unit.quaternion);
    factor.matrix = scale_columns(factor.rotation, factor.scales);
    return factor;
}

// The gradients of the logarithmic scales and of the quaternion, from that of F.
fn scaled_rotation_backward(factor: Factor, g: Rows) -> ShapeGradient {
    let along = factor.rotation.x * g.x + factor.rotation.y * g.y + factor.rotation.z * g.z;
    let g_unit = rotation_backward(factor.unit.quaternion, scale_columns(g, factor.scales));
    return ShapeGradient(factor.scales * along, normalised_backward(factor.unit, g_unit));
}
