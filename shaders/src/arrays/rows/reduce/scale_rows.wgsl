// Every row multiplied by its factor.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>

fn value(row: u32, column: u32) -> f32 {
    return x1[row] * x0[row * COLUMNS_0 + column];
}
