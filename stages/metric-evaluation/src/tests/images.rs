//! Images from integer formulas, which other implementations can compute, too.

use crate::image_file::Image;

/// An image of colours by (column, row, channel), in units of 1/255.
pub(crate) fn image(width: usize, height: usize, colour: impl Fn(i64, i64, i64) -> i64) -> Image {
    let value = |i: usize, c: usize| colour((i % width) as i64, (i / width) as i64, c as i64).clamp(0, 255);
    let plane = |c| (0..width * height).map(|i| value(i, c) as f64 / 255.0).collect();
    Image { width, height, planes: [plane(0), plane(1), plane(2)] }
}

/// An irregular texture.
pub(crate) fn noise(x: i64, y: i64, c: i64) -> i64 {
    (3 * x + 5 * y + 40 * c + (x * x + 3 * y * y + 7 * x * y + 11 * c) % 64) % 256
}

/// The texture of [`noise`] with a perturbation and a darker block.
pub(crate) fn perturbed(x: i64, y: i64, c: i64) -> i64 {
    let value = (noise(x, y, c) + (31 * x + 17 * y + 7 * c + 3 * ((x * y) % 13)) % 41 - 20).clamp(0, 255);
    if (16..40).contains(&x) && (12..30).contains(&y) { value * 3 / 4 } else { value }
}
