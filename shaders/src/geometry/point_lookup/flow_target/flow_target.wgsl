// Lifts optical flow to 3D targets for the points that a view sees. One invocation per point. KNOWS_ARRIVAL is 1 if
// there is a depth map of the view where the flow arrives.
#import gpu::elements
#import gpu::is_finite
#import gpu::nowhere
#const KNOWS_ARRIVAL

struct Flow {
    // Rows of camera_from_world, with the translation last: of the source view, and of the arrival view.
    rows: array<vec4<f32>, 3>,
    rows_to: array<vec4<f32>, 3>,
    focal: vec2<f32>,
    center: vec2<f32>,
    focal_to: vec2<f32>,
    center_to: vec2<f32>,
    // Widths and heights of the source maps and of the arrival map.
    size: vec2<u32>,
    size_to: vec2<u32>,
    // Number of points.
    count: u32,
    depth_tolerance: f32,
    padding: vec2<u32>,
}

@group(0) @binding(0) var<uniform> view: Flow;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> depth: array<f32>;
@group(0) @binding(3) var<storage, read> flow: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> depth_to: array<f32>;
@group(0) @binding(5) var<storage, read_write> positions: array<f32>;
@group(0) @binding(6) var<storage, read_write> free: array<f32>;
@group(0) @binding(7) var<storage, read_write> seen: array<f32>;

struct Target {
    position: vec3<f32>,
    free: vec3<f32>,
    seen: f32,
}

// The texel of a map that contains a position, or NOWHERE.
fn texel_of(pixel: vec2<f32>, size: vec2<u32>) -> u32 {
    let is_number = is_finite(pixel.x) && is_finite(pixel.y);
    if (!is_number || any(pixel < vec2<f32>(0.0)) || any(pixel >= vec2<f32>(size))) {
        return NOWHERE;
    }
    return u32(pixel.y) * size.x + u32(pixel.x);
}

fn is_known(surface: f32) -> bool {
    return is_finite(surface) && surface > 0.0;
}

// Rᵀ·d for the arrival view.
fn rotated_to_world(d: vec3<f32>) -> vec3<f32> {
    return d.x * view.rows_to[0].xyz + d.y * view.rows_to[1].xyz + d.z * view.rows_to[2].xyz;
}

fn target_of(point: vec3<f32>) -> Target {
    var found = Target(vec3<f32>(0.0), vec3<f32>(0.0), 0.0);
    let p = vec4<f32>(point, 1.0);
    let in_view = vec3<f32>(dot(view.rows[0], p), dot(view.rows[1], p), dot(view.rows[2], p));
    if (!(in_view.z > 0.0)) {
        return found;
    }
    let pixel = view.focal * in_view.xy / in_view.z + view.center;
    let texel = texel_of(pixel, view.size);
    if (texel == NOWHERE) {
        return found;
    }
    let surface = depth[texel];
    let shift = flow[texel];
    let is_near = abs(in_view.z - surface) <= view.depth_tolerance * surface;
    if (!is_known(surface) || !is_finite(shift.x) || !is_finite(shift.y) || !is_near) {
        return found;
    }
    let arrival = pixel + shift;
    let ray = vec3<f32>((arrival - view.center_to) / view.focal_to, 1.0);
    var arrival_depth = surface;
    found.free = normalize(rotated_to_world(ray));
    if (KNOWS_ARRIVAL == 1u) {
        let texel_to = texel_of(arrival, view.size_to);
        // The clamp keeps the index in range; a missing texel's value is not used.
        let surface_to = depth_to[min(texel_to, arrayLength(&depth_to) - 1u)];
        if (texel_to != NOWHERE && is_known(surface_to)) {
            arrival_depth = surface_to;
            found.free = vec3<f32>(0.0);
        }
    }
    let translation = vec3<f32>(view.rows_to[0].w, view.rows_to[1].w, view.rows_to[2].w);
    found.position = rotated_to_world(arrival_depth * ray - translation);
    found.seen = 1.0;
    return found;
}

fn run(row: u32) {
    if (row >= view.count) {
        return;
    }
    let found = target_of(vec3<f32>(points[3u * row], points[3u * row + 1u], points[3u * row + 2u]));
    for (var axis = 0u; axis < 3u; axis++) {
        positions[3u * row + axis] = found.position[axis];
        free[3u * row + axis] = found.free[axis];
    }
    seen[row] = found.seen;
}
