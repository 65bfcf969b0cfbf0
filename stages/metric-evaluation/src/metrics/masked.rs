//! Metrics over the pixels of a mask (Gao et al., "Monocular dynamic view synthesis: a reality check", NeurIPS 2022, with
//! the code DyCheck).

use super::psnr::psnr_from_mse;
use super::score::Score;
use super::ssim::{self, RADIUS, TAPS, gaussian_window};
use crate::image_file::Image;

/// Reason for an undefined masked metric.
const EMPTY: &str = "the mask is empty";

/// PSNR in dB over the masked pixels and their channels.
pub(crate) fn masked_psnr(render: &Image, truth: &Image, mask: &[bool]) -> Score {
    let squared = |at: usize| (0..3).map(|c| (render.planes[c][at] - truth.planes[c][at]).powi(2)).sum::<f64>() / 3.0;
    match masked_mean(mask, squared) {
        Score::Value(mse) => Score::Value(psnr_from_mse(mse)),
        undefined => undefined,
    }
}

/// The mean of `value` over the masked pixels.
pub(crate) fn masked_mean(mask: &[bool], value: impl Fn(usize) -> f64) -> Score {
    let kept = (0..mask.len()).filter(|&at| mask[at]);
    let (count, sum) = kept.fold((0_usize, 0.0), |(count, sum), at| (count + 1, sum + value(at)));
    if count == 0 { Score::undefined(EMPTY) } else { Score::Value(sum / count as f64) }
}

/// Two means of SSIM over a mask.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MaskedSsim {
    /// DyCheck's mean over all windows inside the image. The sum over the masked pixels of a window is scaled by the number
    /// of taps divided by the number of masked pixels, first along rows and then along columns; windows outside the mask
    /// count as equal.
    pub(crate) dycheck: Score,
    /// Mean over the windows inside the image whose centre is masked; the weights of a window's masked pixels sum to 1.
    pub(crate) strict: Score,
}

/// SSIM with partial convolutions as window means: pixels outside the mask are skipped.
pub(crate) fn masked_ssim(render: &Image, truth: &Image, mask: &[bool]) -> MaskedSsim {
    let (width, height) = (render.width, render.height);
    let undefined =
        |reason: String| MaskedSsim { dycheck: Score::undefined(&reason), strict: Score::undefined(reason) };
    if !mask.contains(&true) {
        return undefined(EMPTY.into());
    }
    if width.min(height) < TAPS {
        return undefined(format!("image smaller than {TAPS} px"));
    }
    let (left, rows) = (width - TAPS + 1, height - TAPS + 1);
    let has_masked_centre = |window: usize| mask[(window / left + RADIUS) * width + window % left + RADIUS];
    let (mut by_count, mut by_weight) = (Vec::new(), Vec::new());
    for (a, b) in render.planes.iter().zip(&truth.planes) {
        let pixels: Vec<Option<Moments>> = a
            .iter()
            .zip(b)
            .zip(mask)
            .map(|((&a, &b), &kept)| kept.then_some([a, b, a * a, b * b, a * b, 1.0]))
            .collect();
        for (window, Window { scaled, weighted }) in window_sums(&pixels, [width, height]) {
            by_count.push(ssim_of_moments(scaled));
            if has_masked_centre(window) {
                by_weight.push(ssim_of_moments(weighted.map(|sum| sum / weighted[5])));
            }
        }
    }
    let windows = render.planes.len() * left * rows;
    let unseen = (windows - by_count.len()) as f64;
    let strict = match by_weight.len() {
        0 => Score::undefined("no masked pixel is the centre of an SSIM window inside the image"),
        count => Score::Value(by_weight.iter().sum::<f64>() / count as f64),
    };
    MaskedSsim { dycheck: Score::Value((by_count.iter().sum::<f64>() + unseen) / windows as f64), strict }
}

/// a, b, a², b², ab and 1 of a pixel, or sums over the masked pixels of a window.
type Moments = [f64; 6];

/// The sums of a window, with the weights of its taps.
struct Window {
    /// The sums along each axis are multiplied by the number of taps divided by the number of addends.
    scaled: Moments,
    weighted: Moments,
}

/// The windows inside the image with their numbers, row by row, without those outside the mask.
fn window_sums(pixels: &[Option<Moments>], [width, height]: [usize; 2]) -> impl Iterator<Item = (usize, Window)> {
    let weights = gaussian_window();
    let [columns, rows] = [width, height].map(|side| side - TAPS + 1);
    let scale = |kept: usize| TAPS as f64 / kept as f64;
    let along_row = |first: usize| {
        let (mut sums, mut kept) = ([0.0; 6], 0);
        for (weight, moments) in weights.iter().zip(&pixels[first..]) {
            let Some(moments) = moments else { continue };
            kept += 1;
            sums.iter_mut().zip(moments).for_each(|(sum, moment)| *sum += weight * moment);
        }
        (kept > 0).then(|| (sums, scale(kept)))
    };
    let firsts = (0..height).flat_map(|row| (0..columns).map(move |column| row * width + column));
    let along_rows: Vec<Option<(Moments, f64)>> = firsts.map(along_row).collect();
    let along_column = move |first: usize| {
        let (mut window, mut kept) = (Window { scaled: [0.0; 6], weighted: [0.0; 6] }, 0);
        for (weight, sums) in weights.iter().zip(along_rows[first..].iter().step_by(columns)) {
            let Some((sums, scale)) = sums else { continue };
            kept += 1;
            for (at, sum) in sums.iter().enumerate() {
                window.scaled[at] += weight * (sum * scale);
                window.weighted[at] += weight * sum;
            }
        }
        window.scaled = window.scaled.map(|sum| sum * scale(kept));
        (kept > 0).then_some((first, window))
    };
    (0..rows * columns).filter_map(along_column)
}

/// SSIM of a window. DyCheck's scale can give negative variances and covariances above the geometric mean of the
/// variances, so both are clamped.
fn ssim_of_moments([a, b, squares_a, squares_b, products, _]: [f64; 6]) -> f64 {
    let (variance_a, variance_b) = ((squares_a - a * a).max(0.0), (squares_b - b * b).max(0.0));
    let largest = (variance_a * variance_b).sqrt();
    let covariance = (products - a * b).clamp(-largest, largest);
    ssim::index([a, b], [variance_a, variance_b], covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::tests::TOLERANCE;
    use crate::tests::images::{image, noise, perturbed};

    const SIZE: [usize; 2] = [64, 48];

    fn mask(keep: impl Fn(i64, i64) -> bool) -> Vec<bool> {
        (0..SIZE[0] * SIZE[1]).map(|at| keep((at % SIZE[0]) as i64, (at / SIZE[0]) as i64)).collect()
    }

    fn ellipse(x: i64, y: i64) -> bool {
        (x - 30).pow(2) + 2 * (y - 22).pow(2) <= 324
    }

    fn pair() -> [Image; 2] {
        [image(SIZE[0], SIZE[1], noise), image(SIZE[0], SIZE[1], perturbed)]
    }

    fn near(score: &Score, expected: f64) {
        let value = score.value().expect("defined");
        assert!((value - expected).abs() <= TOLERANCE, "{value} instead of {expected}");
    }

    /// Values of an independent implementation, which sums over two-dimensional windows for `strict`; its SSIM agrees with
    /// DyCheck's own code to 1e-15.
    #[test]
    fn masked_metrics_equal_independent_values() {
        let [a, b] = pair();
        for (mask, psnr) in [
            (mask(ellipse), 18.061575672873694),
            (mask(|x, y| !ellipse(x, y)), 26.6741694190462),
            (mask(|x, y| x < 5 && y < 4), 27.268392061009653),
        ] {
            near(&masked_psnr(&a, &b, &mask), psnr);
        }
        for (mask, dycheck, strict) in [
            (mask(ellipse), 0.9591076176376552, Some(0.8477928263517108)),
            (mask(|x, y| !ellipse(x, y)), 0.9336555063876315, Some(0.8931368044966222)),
            (mask(|x, y| x < 5 && y < 4), 0.9999455931516781, None),
            (mask(|_, _| true), 0.8770442945649521, Some(0.8770442945649521)),
        ] {
            let found = masked_ssim(&a, &b, &mask);
            near(&found.dycheck, dycheck);
            match strict {
                Some(strict) => near(&found.strict, strict),
                None => assert!(found.strict.value().is_none(), "every window around a masked pixel leaves the image"),
            }
        }
    }

    /// Whether the mask is large or small, the same error has about the same strict SSIM.
    #[test]
    fn strict_ssim_does_not_depend_on_the_size_of_the_mask() {
        const SIDE: usize = 140;
        let disc = |radius: i64| -> Vec<bool> {
            let from_centre = |at: usize| ((at % SIDE) as i64 - 70).pow(2) + ((at / SIDE) as i64 - 70).pow(2);
            (0..SIDE * SIDE).map(|at| from_centre(at) <= radius * radius).collect()
        };
        let white_noise = |x: i64, y: i64, c: i64, stream: i64| {
            let seed = (x * 73_856_093) ^ (y * 19_349_663) ^ (c * 83_492_791) ^ (stream * 2_654_435_761);
            let mixed = (seed ^ (seed >> 13)).wrapping_mul(1_274_126_177) & 0xffff_ffff;
            ((mixed >> 16) % 256 - 128).div_euclid(2)
        };
        let texture = |x: i64, y: i64, c: i64| 128 + white_noise(x, y, c, 1);
        let truth = image(SIDE, SIDE, texture);
        let strict_of = |render: &Image| {
            [60, 15, 8].map(|radius| masked_ssim(render, &truth, &disc(radius)).strict.value().expect("defined"))
        };
        let noisy = strict_of(&image(SIDE, SIDE, |x, y, c| texture(x, y, c) + white_noise(x, y, c, 2)));
        let grey = strict_of(&image(SIDE, SIDE, |_, _, _| 128));
        for [large, medium, small] in [noisy, grey] {
            assert!((medium - large).abs() < 0.1 && (small - large).abs() < 0.1, "{large}, {medium}, {small}");
        }
        assert!(grey.iter().all(|value| *value < 0.4), "no structure is left: {grey:?}");
    }

    #[test]
    fn empty_masks_and_small_images_are_undefined() {
        let [a, b] = pair();
        let nothing = mask(|_, _| false);
        assert_eq!(masked_psnr(&a, &b, &nothing), Score::undefined(EMPTY));
        assert_eq!(masked_ssim(&a, &b, &nothing).strict, Score::undefined(EMPTY));
        let tiny = image(10, 40, noise);
        assert_eq!(masked_ssim(&tiny, &tiny, &[true; 400]).dycheck, Score::undefined("image smaller than 11 px"));
        let constant = Image { planes: [0, 1, 2].map(|_| vec![0.5; SIZE[0] * SIZE[1]]), ..a.clone() };
        near(&masked_ssim(&constant, &constant, &mask(ellipse)).strict, 1.0);
    }

    /// Planted fault: pixels outside of the mask must not change the result.
    #[test]
    fn errors_outside_of_the_mask_are_ignored() {
        let [a, b] = pair();
        let keep = mask(ellipse);
        let mut elsewhere = b.clone();
        for plane in &mut elsewhere.planes {
            plane.iter_mut().zip(&keep).filter(|(_, kept)| !**kept).for_each(|(value, _)| *value = 0.0);
        }
        assert_eq!(masked_psnr(&a, &b, &keep), masked_psnr(&a, &elsewhere, &keep));
        assert_eq!(masked_ssim(&a, &b, &keep), masked_ssim(&a, &elsewhere, &keep));
        assert_ne!(masked_ssim(&a, &b, &keep), masked_ssim(&a, &b, &mask(|x, y| !ellipse(x, y))));
    }
}
