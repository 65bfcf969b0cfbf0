// Points carried by the frame of a node: the same definitions as on the CPU.
#import geometry::algebra

struct Frames {
    points: u32,
    per_point: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Frames;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> points: array<f32>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(4) var<storage, read> translations: array<f32>;
@group(0) @binding(5) var<storage, read> rotations: array<vec4<f32>>;

fn point_at(point: u32) -> vec3<f32> {
    return vec3<f32>(points[3u * point], points[3u * point + 1u], points[3u * point + 2u]);
}

fn position_of(node: u32) -> vec3<f32> {
    return vec3<f32>(positions[3u * node], positions[3u * node + 1u], positions[3u * node + 2u]);
}

fn translation_of(node: u32) -> vec3<f32> {
    return vec3<f32>(translations[3u * node], translations[3u * node + 1u], translations[3u * node + 2u]);
}

fn rotation_of(node: u32) -> Rows {
    return rotation_matrix(normalised(rotations[node]).quaternion);
}

// R(x − p) + p + t.
fn carried(rotation: Rows, node: u32, x: vec3<f32>) -> vec3<f32> {
    return apply(rotation, x - position_of(node)) + position_of(node) + translation_of(node);
}
