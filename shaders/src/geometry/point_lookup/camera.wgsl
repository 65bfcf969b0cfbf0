// Transforms between world and image: the same definitions as on the CPU.

struct Camera {
    // Rows of camera_from_world, with the translation last.
    rows: array<vec4<f32>, 3>,
    focal: vec2<f32>,
    center: vec2<f32>,
    near_view: f32,
    count: u32,
    padding: vec2<f32>,
}

@group(0) @binding(0) var<uniform> camera: Camera;

// Pixel position of points that are not in front of the camera.
const OUTSIDE: f32 = -1.0;

// R·X + t.
fn view_from_world(point: vec3<f32>) -> vec3<f32> {
    let p = vec4<f32>(point, 1.0);
    return vec3<f32>(dot(camera.rows[0], p), dot(camera.rows[1], p), dot(camera.rows[2], p));
}

// R·d.
fn rotated_to_view(d: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(camera.rows[0].xyz, d), dot(camera.rows[1].xyz, d), dot(camera.rows[2].xyz, d));
}

// Rᵀ·d.
fn rotated_to_world(d: vec3<f32>) -> vec3<f32> {
    return d.x * camera.rows[0].xyz + d.y * camera.rows[1].xyz + d.z * camera.rows[2].xyz;
}

// The direction through a pixel position, scaled to z = 1.
fn ray_view(pixel: vec2<f32>) -> vec3<f32> {
    return vec3<f32>((pixel - camera.center) / camera.focal, 1.0);
}
