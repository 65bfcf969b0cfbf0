// The gradients of rows and of their factors.

fn gradient_0(row: u32, column: u32) -> f32 {
    return x1[row] * dy[row * COLUMNS_0 + column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    var sum = 0.0;
    for (var k = 0u; k < COLUMNS_0; k++) {
        sum += x0[row * COLUMNS_0 + k] * dy[row * COLUMNS_0 + k];
    }
    return sum;
}
