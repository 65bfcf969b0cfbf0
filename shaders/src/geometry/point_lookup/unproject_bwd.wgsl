// The gradients of pixels and depths. One invocation per pixel.
#import geometry::point_lookup::camera
#import gpu::elements

@group(0) @binding(1) var<storage, read> pixels: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read> g_points: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_pixels: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> g_depths: array<f32>;

fn run(pixel: u32) {
    if (pixel >= camera.count) {
        return;
    }
    let at = 3u * pixel;
    let g_view = rotated_to_view(vec3<f32>(g_points[at], g_points[at + 1u], g_points[at + 2u]));
    g_pixels[pixel] = g_view.xy * depths[pixel] / camera.focal;
    g_depths[pixel] = dot(g_view, ray_view(pixels[pixel]));
}
