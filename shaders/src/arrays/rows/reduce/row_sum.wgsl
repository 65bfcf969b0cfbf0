// The sum Σₖ xₖ of every row.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>

fn value(row: u32, column: u32) -> f32 {
    var sum = 0.0;
    for (var k = 0u; k < COLUMNS_0; k++) {
        sum += x0[row * COLUMNS_0 + k];
    }
    return sum;
}
