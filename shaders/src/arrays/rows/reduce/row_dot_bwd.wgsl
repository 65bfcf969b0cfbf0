// The gradients of the dot product of every row.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> dy: array<f32>

fn gradient_0(row: u32, column: u32) -> f32 {
    return dy[row] * x1[row * COLUMNS_0 + column];
}

fn gradient_1(row: u32, column: u32) -> f32 {
    return dy[row] * x0[row * COLUMNS_0 + column];
}
