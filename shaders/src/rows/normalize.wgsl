// x / max(‖x‖, ε) of every row.

fn value(row: u32, column: u32) -> f32 {
    return x0[row * COLUMNS_0 + column] / length_of(row).length;
}
