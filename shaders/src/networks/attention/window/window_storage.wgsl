// What an invocation holds of a window that is too long for its own memory: in an array `held`,
// [WINDOW, invocations] of weights and then of gradients, so that neighbours write neighbours.

var<private> own: u32;
var<private> stride: u32;

// Says which of how many invocations this is.
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

