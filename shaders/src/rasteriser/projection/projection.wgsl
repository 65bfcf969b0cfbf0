// Projects every splat. A culled splat gets zeros and a negative cutoff that encodes the reason. Also counts splats
// culled by the near plane or because of their values, and clamped values. One invocation per splat.
#import geometry::algebra
#import gpu::flat_group
#import gpu::is_finite
#import rasteriser::projection::geometry
#const GIVEN_FACTORS

@group(0) @binding(6) var<storage, read_write> means2d: array<f32>;
@group(0) @binding(7) var<storage, read_write> conics: array<f32>;
@group(0) @binding(8) var<storage, read_write> depths: array<f32>;
@group(0) @binding(9) var<storage, read_write> opacities: array<f32>;
@group(0) @binding(10) var<storage, read_write> colors: array<f32>;
@group(0) @binding(11) var<storage, read_write> cutoffs: array<f32>;
@group(0) @binding(12) var<storage, read_write> counts: array<atomic<u32>>;

// Means farther outside the image than this, in image sizes, count as off-axis.
const MARGIN: f32 = 0.15;

const EVENTS: u32 = 6u;

var<workgroup> group_counts: array<atomic<u32>, EVENTS>;

const UNSEEN: f32 = -1.0;
const NEAR: f32 = -2.0;
const HUGE: f32 = -3.0;
const NOT_FINITE: f32 = -4.0;

// The opacity logit of a hidden splat.
const HIDDEN_LOGIT: f32 = -100.0;

fn parameters_are_finite(splat: u32) -> bool {
    var finite = is_finite3(position_of(splat)) && is_finite(opacity_logits[splat]) && shape_is_finite(splat);
    for (var k = 0u; k < COEFFICIENTS; k++) {
        finite = finite && is_finite3(coefficient(splat, k));
    }
    if (GIVEN_FACTORS == 0u) {
        for (var axis = 0u; axis < 3u; axis++) {
            // Minus infinity is a scale of zero.
            let value = shapes[3u * splat + axis];
            finite = finite && (is_finite(value) || bitcast<u32>(value) == 0xff800000u);
        }
    }
    return finite;
}

fn why_culled(splat: u32, geometry: Geometry) -> f32 {
    if (!parameters_are_finite(splat)) {
        return NOT_FINITE;
    }
    // A hidden splat is unseen wherever it is.
    if (opacity_logits[splat] <= HIDDEN_LOGIT) {
        return UNSEEN;
    }
    let z = geometry.position_view.z;
    if (z < view.near) {
        return NEAR;
    }
    return select(UNSEEN, HUGE, z < view.far && !geometry.usable);
}

fn write_image(
    splat: u32,
    mean2d: vec2<f32>,
    conic: vec3<f32>,
    depth: f32,
    opacity: f32,
    color: vec3<f32>,
    cutoff: f32,
) {
    for (var axis = 0u; axis < 2u; axis++) {
        means2d[2u * splat + axis] = mean2d[axis];
    }
    for (var axis = 0u; axis < 3u; axis++) {
        conics[3u * splat + axis] = conic[axis];
        colors[3u * splat + axis] = color[axis];
    }
    depths[splat] = depth;
    opacities[splat] = opacity;
    cutoffs[splat] = cutoff;
}

// Integer additions do not depend on the order.
fn note(event: u32, times: u32) {
    if (times > 0u) {
        atomicAdd(&group_counts[event], times);
    }
}

fn is_off_axis(mean2d: vec2<f32>) -> bool {
    let at = mean2d / view.size;
    return any(at < vec2<f32>(-MARGIN)) || any(at > vec2<f32>(1.0 + MARGIN));
}

fn project(splat: u32) {
    let geometry = geometry_of(splat);
    let opacity = sigmoid(opacity_logits[splat]);
    let cutoff = log(opacity / view.alpha_min);
    let color = color_of(splat);
    var drawn = geometry.usable && !is_nan(opacity_logits[splat]) && is_finite(cutoff) && cutoff >= 0.0;
    drawn = drawn && touches_image(geometry, cutoff) && is_finite3(color.unclamped) && shape_is_finite(splat);
    if (!drawn) {
        let nothing = vec3<f32>(0.0);
        let why = why_culled(splat, geometry);
        write_image(splat, nothing.xy, nothing, 0.0, 0.0, nothing, why);
        note(0u, u32(why == NEAR));
        note(1u, u32(why == HUGE));
        note(2u, u32(why == NOT_FINITE));
        return;
    }
    let clamped = max(color.unclamped, vec3<f32>(0.0));
    write_image(splat, geometry.mean2d, geometry.conic, geometry.position_view.z, opacity, clamped, cutoff);
    note(3u, u32(is_off_axis(geometry.mean2d)));
    note(4u, u32(opacity > view.alpha_cap));
    let dark = vec3<u32>(clamped == vec3<f32>(0.0));
    note(5u, dark.x + dark.y + dark.z);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < EVENTS) {
        atomicStore(&group_counts[local], 0u);
    }
    workgroupBarrier();
    let splat = flat_group(group, groups) * 64u + local;
    if (splat < view.count) {
        project(splat);
    }
    workgroupBarrier();
    if (local < EVENTS) {
        let sum = atomicLoad(&group_counts[local]);
        if (sum > 0u) {
            atomicAdd(&counts[local], sum);
        }
    }
}
