// The gradients of the image: an invocation per value, which adds up the corners that fall on its texel in their order. The
// texels of the corners are sorted.

struct Corners {
    // Values of the image.
    len: u32,
    channels: u32,
    corners: u32,
}

@group(0) @binding(0) var<uniform> sizes: Corners;
@group(0) @binding(1) var<storage, read> sorted_texels: array<u32>;
@group(0) @binding(2) var<storage, read> corner_of: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> g_values: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_image: array<f32>;

// The first corner that falls on this texel or a later one.
fn first_from(texel: u32) -> u32 {
    var low = 0u;
    var high = sizes.corners;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (sorted_texels[middle] < texel) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    if (index >= sizes.len) {
        return;
    }
    let texel = index / sizes.channels;
    var sum = 0.0;
    for (var at = first_from(texel); at < sizes.corners && sorted_texels[at] == texel; at++) {
        let corner = corner_of[at];
        sum += weights[corner] * g_values[corner / 4u * sizes.channels + index % sizes.channels];
    }
    g_image[index] = sum;
}
