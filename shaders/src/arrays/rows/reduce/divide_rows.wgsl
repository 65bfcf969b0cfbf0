// Every row divided by max(divisor, floor).
#import arrays::rows::map::map_block
#const COLUMNS_0
#extern var<storage, read> x0: array<f32>
#extern var<storage, read> x1: array<f32>

fn value(row: u32, column: u32) -> f32 {
    let floor = map.values[0].x;
    return x0[row * COLUMNS_0 + column] / select(x1[row], floor, x1[row] <= floor);
}
