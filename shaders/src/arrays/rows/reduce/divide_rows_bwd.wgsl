// The gradients of rows divided by max(divisor, floor).
#import arrays::rows::map::map_block
#const COLUMNS_0
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> y: array<f32>
#extern var<storage, read> dy: array<f32>

fn gradient_0(row: u32, column: u32) -> f32 {
    let floor = map.values[0].x;
    return dy[row * COLUMNS_0 + column] / select(x1[row], floor, x1[row] <= floor);
}

// No gradient passes at or below the floor.
fn gradient_1(row: u32, column: u32) -> f32 {
    if (x1[row] <= map.values[0].x) {
        return 0.0;
    }
    var sum = 0.0;
    for (var k = 0u; k < COLUMNS_0; k++) {
        sum += y[row * COLUMNS_0 + k] * dy[row * COLUMNS_0 + k];
    }
    return -(sum / x1[row]);
}
