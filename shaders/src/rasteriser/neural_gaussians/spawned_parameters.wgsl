// Converts the outputs of the anchors' networks to parameters of Gaussians: the same definitions as on the CPU.

struct Spawn {
    anchors: u32,
    per_anchor: u32,
}

@group(0) @binding(0) var<uniform> sizes: Spawn;

// Columns of a shape: three scales and a quaternion.
const SHAPE: u32 = 7u;
// The spherical harmonic of degree 0.
const SH_C0: f32 = 0.28209479177387814;
// Opacities are clamped to this range, because the logits of 0 and 1 are infinite.
const LOW: f32 = 1e-6;
const HIGH: f32 = 0.999999;
// The opacity logit of a hidden Gaussian.
const HIDDEN_LOGIT: f32 = -100.0;

// ln(1 / (1 + e⁻ˣ)) without overflow.
fn log_sigmoid(x: f32) -> f32 {
    return select(0.0, x, x < 0.0) - log(1.0 + exp(-abs(x)));
}

// Clamps an opacity to [LOW, HIGH]; NaN stays NaN.
fn inside(opacity: f32) -> f32 {
    if (opacity < LOW) {
        return LOW;
    } else if (opacity > HIGH) {
        return HIGH;
    }
    return opacity;
}
