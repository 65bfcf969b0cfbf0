// What an anchor's networks say about its Gaussians: the same definitions as on the CPU.

struct Spawn {
    anchors: u32,
    per_anchor: u32,
}

@group(0) @binding(0) var<uniform> sizes: Spawn;

// Columns of a shape: three scales and a quaternion.
const SHAPE: u32 = 7u;
// The constant spherical harmonic.
const SH_C0: f32 = 0.28209479177387814;
// Opacities are kept this far from 0 and 1, where their logit is infinite.
const LOW: f32 = 1e-6;
const HIGH: f32 = 0.999999;
// The logit of what is not there.
const HIDDEN_LOGIT: f32 = -100.0;

// ln(1 / (1 + e⁻ˣ)), from the exponential that cannot overflow.
fn log_sigmoid(x: f32) -> f32 {
    return select(0.0, x, x < 0.0) - log(1.0 + exp(-abs(x)));
}

// An opacity kept off 0 and 1; a NaN stays one.
fn inside(opacity: f32) -> f32 {
    if (opacity < LOW) {
        return LOW;
    } else if (opacity > HIGH) {
        return HIGH;
    }
    return opacity;
}

