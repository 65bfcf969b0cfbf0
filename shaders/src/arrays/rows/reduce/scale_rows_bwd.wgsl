// The gradients of rows and of their factors.
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> dy: array<f32>

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
