// The gradients of the dot product of every row.

fn gradient_0(row: u32, column: u32) -> f32 {
    return dy[row] * x1[row * COLUMNS_0 + column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    return dy[row] * x0[row * COLUMNS_0 + column];
}
