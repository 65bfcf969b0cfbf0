struct Length {
    // max(‖x‖, ε), and whether that is ε.
    length: f32,
    is_short: bool,
}

fn length_of(row: u32) -> Length {
    var squares = 0.0;
    for (var k = 0u; k < COLUMNS_0; k++) {
        squares += x0[row * COLUMNS_0 + k] * x0[row * COLUMNS_0 + k];
    }
    let norm = sqrt(squares);
    let epsilon = map.values[0].x;
    let is_short = norm < epsilon;
    return Length(select(norm, epsilon, is_short), is_short);
}

