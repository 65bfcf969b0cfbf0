// Distances to one.

fn term(at: u32) -> f32 {
    return abs(1.0 - values[at]);
}

fn derivative(at: u32) -> f32 {
    return select(0.0, 1.0, values[at] > 1.0) - select(0.0, 1.0, values[at] < 1.0);
}
