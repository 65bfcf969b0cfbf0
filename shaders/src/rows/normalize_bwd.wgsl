fn gradient_0(row: u32, column: u32) -> f32 {
    let length = length_of(row);
    // From ε on only what is tangential to the sphere passes.
    var radial = 0.0;
    if (!length.is_short) {
        for (var k = 0u; k < COLUMNS_0; k++) {
            radial += y[row * COLUMNS_0 + k] * dy[row * COLUMNS_0 + k];
        }
    }
    let at = row * COLUMNS_0 + column;
    return (dy[at] - radial * y[at]) / length.length;
}
