// What an invocation holds of a window: a number or two per token, in its own memory.

var<private> weights: array<f32, WINDOW>;
var<private> gradients: array<f32, WINDOW>;

// Says which of how many invocations this is.
fn hold_for(index: u32, invocations: u32) {}

fn weight_at(at: u32) -> f32 {
    return weights[at];
}

fn hold_weight(at: u32, value: f32) {
    weights[at] = value;
}

fn gradient_at(at: u32) -> f32 {
    return gradients[at];
}

fn hold_gradient(at: u32, value: f32) {
    gradients[at] = value;
}

