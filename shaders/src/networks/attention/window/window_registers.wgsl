// Per-invocation storage of a window's attention weights and gradients, in private memory.
#const WINDOW

var<private> weights: array<f32, WINDOW>;
var<private> gradients: array<f32, WINDOW>;

// Selects the storage of invocation `index` of `invocations`; private memory needs no selection.
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
