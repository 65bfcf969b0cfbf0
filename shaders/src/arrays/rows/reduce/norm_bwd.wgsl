// The gradient of the norm of every row; 0 for a row of zeros.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> y: array<f32>
#extern var<storage, read> dy: array<f32>

fn gradient_0(row: u32, column: u32) -> f32 {
    if (y[row] == 0.0) {
        return 0.0;
    }
    return dy[row] * x0[row * COLUMNS_0 + column] / y[row];
}
