// The gradients of points. One invocation per point. ARRIVING is a bit mask of the upstream gradients that exist:
// pixels, depths. The placeholder for a missing one is never read.
#import geometry::point_lookup::camera
#import gpu::elements
#const ARRIVING

@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> g_pixels: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read> g_depths: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_points: array<f32>;

fn run(point: u32) {
    if (point >= camera.count) {
        return;
    }
    let p = view_from_world(vec3<f32>(points[3u * point], points[3u * point + 1u], points[3u * point + 2u]));
    var g_view = vec3<f32>(0.0);
    if ((ARRIVING & 2u) != 0u) {
        g_view.z = g_depths[point];
    }
    if ((ARRIVING & 1u) != 0u && p.z > camera.near_view) {
        // u = f·x/z + c: ∂u/∂x = f/z and ∂u/∂z = −f·x/z².
        let along = g_pixels[point] * camera.focal / p.z;
        g_view += vec3<f32>(along, -dot(along, p.xy) / p.z);
    }
    let gradient = rotated_to_world(g_view);
    for (var axis = 0u; axis < 3u; axis++) {
        g_points[3u * point + axis] = gradient[axis];
    }
}
