// The Gaussians that anchors spawn, in the order of the anchors. One invocation per Gaussian.
#import gpu::elements
#import rasteriser::neural_gaussians::spawned_parameters

@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> log_scales: array<f32>;
@group(0) @binding(3) var<storage, read> offsets: array<f32>;
@group(0) @binding(4) var<storage, read> opacities: array<f32>;
@group(0) @binding(5) var<storage, read> shapes: array<f32>;
@group(0) @binding(6) var<storage, read> colors: array<f32>;
@group(0) @binding(7) var<storage, read_write> out_positions: array<f32>;
@group(0) @binding(8) var<storage, read_write> out_log_scales: array<f32>;
@group(0) @binding(9) var<storage, read_write> out_rotations: array<f32>;
@group(0) @binding(10) var<storage, read_write> out_logits: array<f32>;
@group(0) @binding(11) var<storage, read_write> out_sh: array<f32>;

fn run(gaussian: u32) {
    if (gaussian >= sizes.anchors * sizes.per_anchor) {
        return;
    }
    let anchor = gaussian / sizes.per_anchor;
    for (var axis = 0u; axis < 3u; axis++) {
        let at = 3u * gaussian + axis;
        out_positions[at] = positions[3u * anchor + axis] + offsets[at] * exp(log_scales[6u * anchor + axis]);
        out_log_scales[at] = log_scales[6u * anchor + 3u + axis] + log_sigmoid(shapes[SHAPE * gaussian + axis]);
        out_sh[at] = (colors[at] - 0.5) / SH_C0;
    }
    for (var part = 0u; part < 4u; part++) {
        out_rotations[4u * gaussian + part] = shapes[SHAPE * gaussian + 3u + part];
    }
    let opacity = inside(opacities[gaussian]);
    out_logits[gaussian] = select(log(opacity / (1.0 - opacity)), HIDDEN_LOGIT, opacities[gaussian] <= 0.0);
}
