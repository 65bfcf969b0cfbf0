// The gradients of what belongs to one Gaussian, zero where it was left out: an invocation per slot. ARRIVING tells by bits
// which of the gradients of positions, scales, rotations, logits and harmonics there are; what stands in for another is not
// read.

@group(0) @binding(1) var<storage, read> log_scales: array<f32>;
@group(0) @binding(2) var<storage, read> opacities: array<f32>;
@group(0) @binding(3) var<storage, read> shapes: array<f32>;
@group(0) @binding(4) var<storage, read> slots: array<u32>;
@group(0) @binding(5) var<storage, read> first: array<u32>;
@group(0) @binding(6) var<storage, read> by_position: array<f32>;
@group(0) @binding(7) var<storage, read> by_log_scale: array<f32>;
@group(0) @binding(8) var<storage, read> by_rotation: array<f32>;
@group(0) @binding(9) var<storage, read> by_logit: array<f32>;
@group(0) @binding(10) var<storage, read> by_harmonic: array<f32>;
@group(0) @binding(11) var<storage, read_write> g_offsets: array<f32>;
@group(0) @binding(12) var<storage, read_write> g_opacities: array<f32>;
@group(0) @binding(13) var<storage, read_write> g_shapes: array<f32>;
@group(0) @binding(14) var<storage, read_write> g_colors: array<f32>;

// The Gaussian of a slot.
fn gaussian_of(slot: u32) -> u32 {
    let anchor = slot / sizes.per_anchor;
    for (var gaussian = first[anchor]; gaussian < first[anchor + 1u]; gaussian++) {
        if (slots[gaussian] == slot) {
            return gaussian;
        }
    }
    return NOWHERE;
}

fn arrives(gaussian: u32, bit: u32) -> bool {
    return gaussian != NOWHERE && (ARRIVING & (1u << bit)) != 0u;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = flat_group(group, groups) * 256u + local;
    if (slot >= sizes.anchors * sizes.per_anchor) {
        return;
    }
    let anchor = slot / sizes.per_anchor;
    let gaussian = gaussian_of(slot);
    for (var axis = 0u; axis < 3u; axis++) {
        var g_offset = 0.0;
        if (arrives(gaussian, 0u)) {
            g_offset = by_position[3u * gaussian + axis] * exp(log_scales[6u * anchor + axis]);
        }
        g_offsets[3u * slot + axis] = g_offset;
        var g_scale = 0.0;
        if (arrives(gaussian, 1u)) {
            // d ln sigmoid(c) = sigmoid(−c) dc.
            g_scale = by_log_scale[3u * gaussian + axis] * exp(log_sigmoid(-shapes[SHAPE * slot + axis]));
        }
        g_shapes[SHAPE * slot + axis] = g_scale;
        var g_color = 0.0;
        if (arrives(gaussian, 4u)) {
            g_color = by_harmonic[3u * gaussian + axis] / SH_C0;
        }
        g_colors[3u * slot + axis] = g_color;
    }
    for (var part = 0u; part < 4u; part++) {
        var g_rotation = 0.0;
        if (arrives(gaussian, 2u)) {
            g_rotation = by_rotation[4u * gaussian + part];
        }
        g_shapes[SHAPE * slot + 3u + part] = g_rotation;
    }
    var g_opacity = 0.0;
    let opacity = opacities[slot];
    if (arrives(gaussian, 3u) && !(opacity < LOW) && !(opacity > HIGH)) {
        g_opacity = by_logit[gaussian] / (opacity * (1.0 - opacity));
    }
    g_opacities[slot] = g_opacity;
}
