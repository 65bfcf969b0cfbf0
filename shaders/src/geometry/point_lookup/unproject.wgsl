// Unprojects pixels with depths to points. One invocation per pixel.
#import geometry::point_lookup::camera
#import gpu::elements

@group(0) @binding(1) var<storage, read> pixels: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read_write> points: array<f32>;

fn run(pixel: u32) {
    if (pixel >= camera.count) {
        return;
    }
    let translation = vec3<f32>(camera.rows[0].w, camera.rows[1].w, camera.rows[2].w);
    let point = rotated_to_world(depths[pixel] * ray_view(pixels[pixel]) - translation);
    for (var axis = 0u; axis < 3u; axis++) {
        points[3u * pixel + axis] = point[axis];
    }
}
