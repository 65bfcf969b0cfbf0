// Slices one 4D Gaussian at an instant: the same definitions as the CPU reference. A matrix is stored as the list of
// its rows, so the product of a and b is written b * a, and that of a row v and b is written b * v.
#import geometry::algebra

// The smallest standard deviation in time, in units of time.
const MIN_DEVIATION_TIME: f32 = 1e-4;
// A row with a smaller squared length has no direction.
const MIN_SQUARED_LENGTH: f32 = 1e-30;
// Lower bound that keeps the logarithm of 1 − opacity finite.
const MIN_TRANSPARENCY: f32 = 1e-30;

struct Gaussian {
    // Logarithms of the standard deviations along x, y, z, t before rotation.
    log_scales: vec4<f32>,
    rotation_left: vec4<f32>,
    rotation_right: vec4<f32>,
    // t − μₜ.
    offset_time: f32,
    opacity_logit: f32,
}

// L = R·diag(eˢ).
struct Axes {
    scales: vec4<f32>,
    left: Unit,
    right: Unit,
    lengths: mat4x4<f32>,
}

// The last row of L: its length is the standard deviation in time, its direction is orthogonal to the slice.
struct TimeRow {
    direction: vec4<f32>,
    // Zero if there is no direction.
    inverse_length: f32,
    deviation: f32,
    is_clamped: bool,
}

struct Cut {
    // The unit normal û of the Householder reflection H = I − 2ûûᵀ, and the inverse of its length before normalisation.
    normal: vec4<f32>,
    inverse_normal_length: f32,
    velocity: vec3<f32>,
    // The reflected rows without their last column.
    factor: Rows,
}

// The logit of an opacity times a share, and its derivatives with respect to the opacity's logit and the logarithm of
// the share.
struct Faded {
    logit: f32,
    by_logit: f32,
    by_log_share: f32,
}

// The matrix of p ↦ q ⊗ p.
fn left_matrix(q: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(
        vec4<f32>(q.x, -q.w, q.z, q.y),
        vec4<f32>(q.w, q.x, -q.y, q.z),
        vec4<f32>(-q.z, q.y, q.x, q.w),
        vec4<f32>(-q.y, -q.z, -q.w, q.x),
    );
}

// The matrix of p ↦ p ⊗ q̄.
fn right_matrix(q: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(
        vec4<f32>(q.x, -q.w, q.z, -q.y),
        vec4<f32>(q.w, q.x, -q.y, -q.z),
        vec4<f32>(-q.z, q.y, q.x, -q.w),
        vec4<f32>(q.y, q.z, q.w, q.x),
    );
}

fn axes_of(gaussian: Gaussian) -> Axes {
    let scales = exp(gaussian.log_scales);
    let left = normalised(gaussian.rotation_left);
    let right = normalised(gaussian.rotation_right);
    let rotation = right_matrix(right.quaternion) * left_matrix(left.quaternion);
    let lengths = mat4x4<f32>(rotation[0] * scales, rotation[1] * scales, rotation[2] * scales, rotation[3] * scales);
    return Axes(scales, left, right, lengths);
}

fn time_row_of(row: vec4<f32>) -> TimeRow {
    let squared = dot(row, row);
    if (squared < MIN_SQUARED_LENGTH) {
        return TimeRow(vec4<f32>(0.0, 0.0, 0.0, 1.0), 0.0, MIN_DEVIATION_TIME, true);
    }
    let length = sqrt(squared);
    let inverse_length = 1.0 / length;
    return TimeRow(row * inverse_length, inverse_length, max(length, MIN_DEVIATION_TIME), length < MIN_DEVIATION_TIME);
}

// The logarithm of the share of the opacity that remains at the instant.
fn log_share(offset_time: f32, deviation: f32) -> f32 {
    let offset = offset_time / deviation;
    return -0.5 * offset * offset;
}

// v·(I − 2ûûᵀ).
fn reflected(v: vec4<f32>, normal: vec4<f32>) -> vec4<f32> {
    return v - 2.0 * dot(v, normal) * normal;
}

fn cut_of(axes: Axes, time_row: TimeRow) -> Cut {
    // The reflection maps the time row to the farther of ± the last axis, so that the normal is never short.
    var normal = time_row.direction;
    normal.w += select(-1.0, 1.0, normal.w >= 0.0);
    let inverse_normal_length = 1.0 / sqrt(dot(normal, normal));
    normal *= inverse_normal_length;
    let along = vec3<f32>(
        dot(axes.lengths[0], time_row.direction),
        dot(axes.lengths[1], time_row.direction),
        dot(axes.lengths[2], time_row.direction),
    );
    let factor = Rows(
        reflected(axes.lengths[0], normal).xyz,
        reflected(axes.lengths[1], normal).xyz,
        reflected(axes.lengths[2], normal).xyz,
    );
    return Cut(normal, inverse_normal_length, along / time_row.deviation, factor);
}

// σ(x)·w = σ(ln w − ln(e⁻ˣ + 1 − w)). For negative x, e⁻ˣ is factored out of the logarithm to avoid overflow.
fn faded(logit: f32, log_share: f32) -> Faded {
    let share = exp(log_share);
    let rest = 1.0 - share;
    let e = exp(-abs(logit));
    if (logit >= 0.0) {
        let sum = max(e + rest, MIN_TRANSPARENCY);
        return Faded(log_share - log(sum), e / sum, 1.0 + share / sum);
    }
    let sum = 1.0 + e * rest;
    return Faded(log_share + logit - log(sum), 1.0 / sum, 1.0 + e * share / sum);
}
