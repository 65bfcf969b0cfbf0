// Every row multiplied by its factor.

fn value(row: u32, column: u32) -> f32 {
    return x1[row] * x0[row * COLUMNS_0 + column];
}
