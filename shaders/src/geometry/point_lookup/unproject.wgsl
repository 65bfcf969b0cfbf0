// Unprojects pixels with depths to points. One invocation per pixel.

@group(0) @binding(1) var<storage, read> pixels: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read_write> points: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = flat_group(group, groups) * 256u + local;
    if (pixel >= camera.count) {
        return;
    }
    let translation = vec3<f32>(camera.rows[0].w, camera.rows[1].w, camera.rows[2].w);
    let point = rotated_to_world(depths[pixel] * ray_view(pixels[pixel]) - translation);
    for (var axis = 0u; axis < 3u; axis++) {
        points[3u * pixel + axis] = point[axis];
    }
}
