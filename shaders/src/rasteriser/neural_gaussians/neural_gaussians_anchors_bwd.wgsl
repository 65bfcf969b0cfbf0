// The gradients of the anchors' positions and scales: sums over each anchor's Gaussians in order. One invocation per
// anchor. ARRIVING is a bit mask of the upstream gradients that exist: positions, scales. The placeholder for a missing
// one is never read.
#import gpu::elements
#import rasteriser::neural_gaussians::spawned_parameters
#const ARRIVING

@group(0) @binding(1) var<storage, read> log_scales: array<f32>;
@group(0) @binding(2) var<storage, read> offsets: array<f32>;
@group(0) @binding(3) var<storage, read> by_position: array<f32>;
@group(0) @binding(4) var<storage, read> by_log_scale: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_positions: array<f32>;
@group(0) @binding(6) var<storage, read_write> g_log_scales: array<f32>;

fn run(anchor: u32) {
    if (anchor >= sizes.anchors) {
        return;
    }
    for (var axis = 0u; axis < 3u; axis++) {
        let scale = exp(log_scales[6u * anchor + axis]);
        var g_position = 0.0;
        var g_reach = 0.0;
        var g_scale = 0.0;
        for (var k = 0u; k < sizes.per_anchor; k++) {
            let at = 3u * (anchor * sizes.per_anchor + k) + axis;
            if ((ARRIVING & 1u) != 0u) {
                let g = by_position[at];
                g_position += g;
                g_reach += g * offsets[at] * scale;
            }
            if ((ARRIVING & 2u) != 0u) {
                g_scale += by_log_scale[at];
            }
        }
        g_positions[3u * anchor + axis] = g_position;
        g_log_scales[6u * anchor + axis] = g_reach;
        g_log_scales[6u * anchor + 3u + axis] = g_scale;
    }
}
