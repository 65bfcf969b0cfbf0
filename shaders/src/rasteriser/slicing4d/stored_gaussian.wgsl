// The stored parameters of the 4D Gaussians.
#import rasteriser::slicing4d::time_slice

struct Slicing {
    time: f32,
    // A Gaussian is hidden if the logarithm of its share is at or below this.
    least_log_share: f32,
    // The opacity logit of a hidden Gaussian.
    hidden_logit: f32,
    count: u32,
}

@group(0) @binding(0) var<uniform> slicing: Slicing;
@group(0) @binding(1) var<storage, read> log_scales: array<f32>;
@group(0) @binding(2) var<storage, read> log_scales_time: array<f32>;
@group(0) @binding(3) var<storage, read> rotations_left: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> rotations_right: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> times: array<f32>;
@group(0) @binding(6) var<storage, read> opacity_logits: array<f32>;

fn gaussian_of(row: u32) -> Gaussian {
    let at = 3u * row;
    let scales = vec4<f32>(log_scales[at], log_scales[at + 1u], log_scales[at + 2u], log_scales_time[row]);
    return Gaussian(scales, rotations_left[row], rotations_right[row], slicing.time - times[row], opacity_logits[row]);
}

// Written so that NaN counts as present and is detected later.
fn is_present(gaussian: Gaussian, time_row: TimeRow) -> bool {
    return !(log_share(gaussian.offset_time, time_row.deviation) <= slicing.least_log_share);
}
