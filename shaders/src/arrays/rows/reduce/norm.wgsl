// The norm ‖x‖ of every row.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>

fn value(row: u32, column: u32) -> f32 {
    var squares = 0.0;
    for (var k = 0u; k < COLUMNS_0; k++) {
        squares += x0[row * COLUMNS_0 + k] * x0[row * COLUMNS_0 + k];
    }
    return sqrt(squares);
}
