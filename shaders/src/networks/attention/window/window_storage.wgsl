// Per-invocation storage of a window's attention weights and gradients, for windows that are too long for private
// memory. The array `held` has [WINDOW, invocations] weights, then as many gradients, so that neighbouring invocations
// access neighbouring elements.
#const WINDOW
#extern var<storage, read_write> held: array<f32>

var<private> own: u32;
var<private> stride: u32;

// Selects the storage of invocation `index` of `invocations`.
fn hold_for(index: u32, invocations: u32) {
    own = index;
    stride = invocations;
}

fn weight_at(at: u32) -> f32 {
    return held[at * stride + own];
}

fn hold_weight(at: u32, value: f32) {
    held[at * stride + own] = value;
}

fn gradient_at(at: u32) -> f32 {
    return held[(WINDOW + at) * stride + own];
}

fn hold_gradient(at: u32, value: f32) {
    held[(WINDOW + at) * stride + own] = value;
}
