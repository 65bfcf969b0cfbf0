// Projects points to pixels and depths. One invocation per point.

@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> pixels: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read_write> depths: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let point = flat_group(group, groups) * 256u + local;
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
