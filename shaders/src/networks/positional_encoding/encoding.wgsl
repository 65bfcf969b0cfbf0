// Positional encoding: x if WITH_INPUT is 1, then sin x, cos x, sin 2x, cos 2x, sin 4x, …, each with COLUMNS_0 columns.
#import gpu::sine
#const COLUMNS_0, WITH_INPUT
#extern var<storage, read> x0: array<f32>

fn value(row: u32, column: u32) -> f32 {
    let block = column / COLUMNS_0;
    let x = x0[row * COLUMNS_0 + column % COLUMNS_0];
    if (block < WITH_INPUT) {
        return x;
    }
    let wave = block - WITH_INPUT;
    let angle = f32(1u << (wave / 2u)) * x;
    return sine_and_cosine(angle)[wave % 2u];
}
