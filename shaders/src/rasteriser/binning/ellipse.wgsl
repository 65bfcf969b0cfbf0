// The ellipse σ ≤ cutoff with σ = ½(A(dx + k·dy)² + m·dy²), slightly enlarged: the same definitions as on the CPU.

// Relative and absolute enlargement of the cutoff, and relative enlargement of an interval's coordinates.
const CUTOFF_SLACK: f32 = 1e-4;
const COORDINATE_SLACK: f32 = 1e-6;

struct Ellipse {
    center: vec2<f32>,
    // A, k, m.
    conic: vec3<f32>,
    // 2·cutoff.
    squared_radius: f32,
    half_extents: vec2<f32>,
    // y offset of the rightmost point from the centre.
    tip_offset: f32,
}

fn ellipse_around(center: vec2<f32>, conic: vec3<f32>, cutoff: f32) -> Ellipse {
    var ellipse: Ellipse;
    ellipse.center = center;
    ellipse.conic = conic;
    ellipse.squared_radius = 2.0 * (cutoff + cutoff * CUTOFF_SLACK + CUTOFF_SLACK);
    // The covariance from the conic: var y = 1/m, var x = 1/A + k²/m, cov = −k/m.
    let k = ellipse.conic.y;
    let variance_y = 1.0 / ellipse.conic.z;
    let variance_x = 1.0 / ellipse.conic.x + k * k / ellipse.conic.z;
    ellipse.half_extents = sqrt(ellipse.squared_radius * vec2<f32>(variance_x, variance_y));
    ellipse.tip_offset = -k * variance_y / variance_x * ellipse.half_extents.x;
    return ellipse;
}

// Half the width at a y offset from the centre.
fn half_width(ellipse: Ellipse, offset_y: f32) -> f32 {
    let remaining = max(ellipse.squared_radius - ellipse.conic.z * offset_y * offset_y, 0.0);
    return sqrt(remaining / ellipse.conic.x);
}

// The projection onto the x axis of the part between two y coordinates, as (start, end); end < start if the part is
// empty. The part is convex, so its extremes lie at the left and right tips or, if these are outside, at the nearer y
// coordinate.
fn shadow_between(ellipse: Ellipse, first: f32, last: f32) -> vec2<f32> {
    let lowest = max(first - ellipse.center.y, -ellipse.half_extents.y);
    let highest = min(last - ellipse.center.y, ellipse.half_extents.y);
    if (!(lowest <= highest)) {
        return vec2<f32>(3e38, -3e38);
    }
    let k = ellipse.conic.y;
    let at_right = min(max(ellipse.tip_offset, lowest), highest);
    let at_left = min(max(-ellipse.tip_offset, lowest), highest);
    let right = -k * at_right + half_width(ellipse, at_right);
    let left = -k * at_left - half_width(ellipse, at_left);
    let slack = COORDINATE_SLACK * (abs(ellipse.center.x) + ellipse.half_extents.x);
    return vec2<f32>(ellipse.center.x + left - slack, ellipse.center.x + right + slack);
}
