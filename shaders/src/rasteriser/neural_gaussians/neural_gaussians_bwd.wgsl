// The gradients of offsets, opacities, shapes and colours. One invocation per Gaussian. ARRIVING is a bit mask of the
// upstream gradients that exist: positions, scales, rotations, logits, harmonics. The placeholder for a missing one is
// never read.
#import gpu::elements
#import rasteriser::neural_gaussians::spawned_parameters
#const ARRIVING

@group(0) @binding(1) var<storage, read> log_scales: array<f32>;
@group(0) @binding(2) var<storage, read> opacities: array<f32>;
@group(0) @binding(3) var<storage, read> shapes: array<f32>;
@group(0) @binding(4) var<storage, read> by_position: array<f32>;
@group(0) @binding(5) var<storage, read> by_log_scale: array<f32>;
@group(0) @binding(6) var<storage, read> by_rotation: array<f32>;
@group(0) @binding(7) var<storage, read> by_logit: array<f32>;
@group(0) @binding(8) var<storage, read> by_harmonic: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_offsets: array<f32>;
@group(0) @binding(10) var<storage, read_write> g_opacities: array<f32>;
@group(0) @binding(11) var<storage, read_write> g_shapes: array<f32>;
@group(0) @binding(12) var<storage, read_write> g_colors: array<f32>;

fn arrives(bit: u32) -> bool {
    return (ARRIVING & (1u << bit)) != 0u;
}

fn run(gaussian: u32) {
    if (gaussian >= sizes.anchors * sizes.per_anchor) {
        return;
    }
    let anchor = gaussian / sizes.per_anchor;
    for (var axis = 0u; axis < 3u; axis++) {
        var g_offset = 0.0;
        if (arrives(0u)) {
            g_offset = by_position[3u * gaussian + axis] * exp(log_scales[6u * anchor + axis]);
        }
        g_offsets[3u * gaussian + axis] = g_offset;
        var g_scale = 0.0;
        if (arrives(1u)) {
            // d ln sigmoid(c) = sigmoid(−c) dc.
            g_scale = by_log_scale[3u * gaussian + axis] * exp(log_sigmoid(-shapes[SHAPE * gaussian + axis]));
        }
        g_shapes[SHAPE * gaussian + axis] = g_scale;
        var g_color = 0.0;
        if (arrives(4u)) {
            g_color = by_harmonic[3u * gaussian + axis] / SH_C0;
        }
        g_colors[3u * gaussian + axis] = g_color;
    }
    for (var part = 0u; part < 4u; part++) {
        var g_rotation = 0.0;
        if (arrives(2u)) {
            g_rotation = by_rotation[4u * gaussian + part];
        }
        g_shapes[SHAPE * gaussian + 3u + part] = g_rotation;
    }
    var g_opacity = 0.0;
    let opacity = opacities[gaussian];
    // A clamped or hidden opacity has no gradient.
    if (arrives(3u) && !(opacity < LOW) && !(opacity > HIGH)) {
        g_opacity = by_logit[gaussian] / (opacity * (1.0 - opacity));
    }
    g_opacities[gaussian] = g_opacity;
}
