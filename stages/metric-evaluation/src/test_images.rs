//! Images from integer formulas, which other implementations compute too.

use crate::Image;

/// Colours by (column, row, channel), in 255ths.
pub fn image(width: usize, height: usize, colour: impl Fn(i64, i64, i64) -> i64) -> Image {
    let value = |i: usize, c: usize| colour((i % width) as i64, (i / width) as i64, c as i64).clamp(0, 255);
    let plane = |c| (0..width * height).map(|i| value(i, c) as f64 / 255.0).collect();
    Image { width, height, planes: [plane(0), plane(1), plane(2)] }
}

/// A texture without a pattern that fits any filter.
pub fn noise(x: i64, y: i64, c: i64) -> i64 {
    (3 * x + 5 * y + 40 * c + (x * x + 3 * y * y + 7 * x * y + 11 * c) % 64) % 256
}

/// The same, disturbed, with a darker block.
pub fn perturbed(x: i64, y: i64, c: i64) -> i64 {
    let value = (noise(x, y, c) + (31 * x + 17 * y + 7 * c + 3 * ((x * y) % 13)) % 41 - 20).clamp(0, 255);
    if (16..40).contains(&x) && (12..30).contains(&y) { value * 3 / 4 } else { value }
}
