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
        let pixels: Vec<Moments> = a
            .iter()
            .zip(b)
            .zip(mask)
            .map(|((&a, &b), &kept)| kept.then_some([a, b, a * a, b * b, a * b, 1.0]))
            .collect();
        let scaled = window_sums(&pixels, [width, height], |kept| TAPS as f64 / kept as f64);
        by_count.extend(scaled.into_iter().flatten().map(ssim_of_moments));
        let centred = window_sums(&pixels, [width, height], |_| 1.0).into_iter().enumerate();
        let centred = centred.filter(|(window, _)| has_masked_centre(*window)).filter_map(|(_, sums)| sums);
        by_weight.extend(centred.map(|sums| ssim_of_moments(sums.map(|sum| sum / sums[5]))));
    }
    let windows = render.planes.len() * left * rows;
    let unseen = (windows - by_count.len()) as f64;
    let strict = match by_weight.len() {
        0 => Score::undefined("no masked pixel is the centre of an SSIM window inside the image"),
        count => Score::Value(by_weight.iter().sum::<f64>() / count as f64),
    };
    MaskedSsim { dycheck: Score::Value((by_count.iter().sum::<f64>() + unseen) / windows as f64), strict }
}

/// Weighted sums of a, b, a², b², ab and 1 over the masked pixels of a window; `None` for a window outside the mask.
type Moments = Option<[f64; 6]>;

/// The sums of all windows inside the image, row by row. Along each axis they are multiplied by `scale` of the number of
/// addends.
fn window_sums(pixels: &[Moments], [width, height]: [usize; 2], scale: fn(usize) -> f64) -> Vec<Moments> {
    let along_rows = partial_sums(pixels, [height, width], [width, 1], scale);
    // The rows of the result are shorter by one window; columns come next.
    let left = width - TAPS + 1;
    partial_sums(&along_rows, [left, height], [1, left], scale)
}

/// Window sums along the second of two axes with these lengths and strides, for windows inside the image. The result keeps
/// the memory order of the axes.
fn partial_sums(
    values: &[Moments],
    [across, along]: [usize; 2],
    [line, step]: [usize; 2],
    scale: fn(usize) -> f64,
) -> Vec<Moments> {
    let window = gaussian_window();
    let windows = along - TAPS + 1;
    let sum = |line_at: usize, first: usize| {
        let (mut sums, mut kept) = ([0.0; 6], 0_usize);
        for (tap, weight) in window.iter().enumerate() {
            let Some(moments) = values[line_at * line + (first + tap) * step] else { continue };
            kept += 1;
            sums.iter_mut().zip(moments).for_each(|(sum, moment)| *sum += weight * moment);
        }
        (kept > 0).then(|| sums.map(|sum| sum * scale(kept)))
    };
    if step == 1 {
        (0..across)
            .flat_map(|at| (0..windows).map(move |first| (at, first)))
            .map(|(at, first)| sum(at, first))
            .collect()
    } else {
        (0..windows)
            .flat_map(|first| (0..across).map(move |at| (at, first)))
            .map(|(at, first)| sum(at, first))
            .collect()
    }
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
