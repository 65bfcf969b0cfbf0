// Every row divided by max(divisor, floor).

fn value(row: u32, column: u32) -> f32 {
    let floor = map.values[0].x;
    return x0[row * COLUMNS_0 + column] / select(x1[row], floor, x1[row] <= floor);
}
