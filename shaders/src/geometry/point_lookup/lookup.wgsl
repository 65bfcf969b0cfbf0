// Samples an image at every position. One invocation per position.

@group(0) @binding(3) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = flat_group(group, groups) * 64u + local;
    if (at >= sizes.count) {
        return;
    }
    var window = window_of(pixels[at]);
    for (var channel = 0u; channel < sizes.channels; channel++) {
        var sum = 0.0;
        for (var corner = 0u; corner < 4u; corner++) {
            // A texel with weight 0 may be infinite.
            if (window.valid && window.weights[corner] != 0.0) {
                sum += window.weights[corner] * image[window.texels[corner] * sizes.channels + channel];
            }
        }
        values[at * sizes.channels + channel] = sum;
    }
}
