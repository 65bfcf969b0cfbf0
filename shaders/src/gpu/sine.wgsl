// Sines and cosines with an absolute error below 1e-7 for angles up to 10⁴. WGSL allows its built-in functions an error of 2⁻¹¹
// between −π and π, and any error outside.

// π/2 as a sum: products of the first two numbers with whole numbers below 2¹³ are exact.
const QUARTER_HIGH: f32 = 1.5703125;
const QUARTER_MIDDLE: f32 = 4.837512969970703e-4;
const QUARTER_LOW: f32 = 7.549790126404332e-8;

// sin x and cos x.
fn sine_and_cosine(x: f32) -> vec2<f32> {
    let turns = round(0.6366197723675814 * x);
    let rest = ((x - turns * QUARTER_HIGH) - turns * QUARTER_MIDDLE) - turns * QUARTER_LOW;
    // Taylor series: up to π/4, the omitted terms are below 2e-9.
    let z = rest * rest;
    let sine = rest + rest * z * (((z / 362880.0 - 1.0 / 5040.0) * z + 1.0 / 120.0) * z - 1.0 / 6.0);
    let series = ((z / -3628800.0 + 1.0 / 40320.0) * z - 1.0 / 720.0) * z + 1.0 / 24.0;
    let cosine = (1.0 - 0.5 * z) + z * z * series;
    let quarter = u32(i32(turns)) & 3u;
    let pair = select(vec2<f32>(sine, cosine), vec2<f32>(cosine, -sine), (quarter & 1u) == 1u);
    return select(pair, -pair, quarter >= 2u);
}
