// The gradient of x, summed over BANDS frequency bands.
#const BANDS, COLUMNS_0, COLUMNS_Y, WITH_INPUT
#extern var<storage, read> y: array<f32>
#extern var<storage, read> dy: array<f32>

// The gradient of x, summed over BANDS frequency bands.

fn gradient_0(row: u32, column: u32) -> f32 {
    let first = row * COLUMNS_Y + column;
    var sum = 0.0;
    if (WITH_INPUT == 1u) {
        sum = dy[first];
    }
    for (var band = 0u; band < BANDS; band++) {
        let sine = first + COLUMNS_0 * (2u * band + WITH_INPUT);
        let cosine = sine + COLUMNS_0;
        sum += f32(1u << band) * (y[cosine] * dy[sine] - y[sine] * dy[cosine]);
    }
    return sum;
}
