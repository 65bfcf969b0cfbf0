// Projects points to pixels and depths. One invocation per point.
#import geometry::point_lookup::camera
#import gpu::elements

@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> pixels: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read_write> depths: array<f32>;

fn run(point: u32) {
    if (point >= camera.count) {
        return;
    }
    let p = view_from_world(vec3<f32>(points[3u * point], points[3u * point + 1u], points[3u * point + 2u]));
    var pixel = vec2<f32>(OUTSIDE);
    if (p.z > camera.near_view) {
        pixel = camera.focal * p.xy / p.z + camera.center;
    }
    pixels[point] = pixel;
    depths[point] = p.z;
}
