//! Metrics over the pixels of a mask (Gao et al., "Monocular dynamic view synthesis: a reality check", NeurIPS 2022, with
//! the code DyCheck).

use super::psnr::psnr_from_mse;
use super::score::Score;
use super::ssim::{self, TAPS, gaussian_window};
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
    /// DyCheck's mean over all windows inside the image; windows outside the mask count as equal.
    pub(crate) dycheck: Score,
    /// Mean over the windows that intersect the mask.
    pub(crate) strict: Score,
}

/// SSIM with partial convolutions as window means: pixels outside the mask are skipped, and the sum is scaled by the
/// number of taps divided by the number of masked pixels, first along rows and then along columns.
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
    let (mut seen, mut sum_seen, mut windows) = (0_usize, 0.0, 0_usize);
    for (a, b) in render.planes.iter().zip(&truth.planes) {
        let moments: Vec<Moments> =
            a.iter().zip(b).zip(mask).map(|((&a, &b), &kept)| kept.then_some([a, b, a * a, b * b, a * b])).collect();
        let along_rows = partial_means(&moments, [height, width], [width, 1]);
        // The rows of the result are shorter by one window; columns come next.
        let left = width - TAPS + 1;
        let along_columns = partial_means(&along_rows, [left, height], [1, left]);
        windows += along_columns.len();
        for moments in along_columns.into_iter().flatten() {
            seen += 1;
            sum_seen += ssim_of_moments(moments);
        }
    }
    let unseen = (windows - seen) as f64;
    let strict = match seen {
        0 => Score::undefined("no SSIM window intersects the mask"),
        _ => Score::Value(sum_seen / seen as f64),
    };
    MaskedSsim { dycheck: Score::Value((sum_seen + unseen) / windows as f64), strict }
}

/// Window means of a, b, a², b² and ab; `None` for a window outside the mask.
type Moments = Option<[f64; 5]>;

/// Window means along the second of two axes with these lengths and strides, for windows inside the image. The result keeps
/// the memory order of the axes.
fn partial_means(values: &[Moments], [across, along]: [usize; 2], [line, step]: [usize; 2]) -> Vec<Moments> {
    let window = gaussian_window();
    let windows = along - TAPS + 1;
    let mean = |line_at: usize, first: usize| {
        let (mut sums, mut kept) = ([0.0; 5], 0_usize);
        for (tap, weight) in window.iter().enumerate() {
            let Some(moments) = values[line_at * line + (first + tap) * step] else { continue };
            kept += 1;
            sums.iter_mut().zip(moments).for_each(|(sum, moment)| *sum += weight * moment);
        }
        (kept > 0).then(|| sums.map(|sum| sum * TAPS as f64 / kept as f64))
    };
    if step == 1 {
        (0..across)
            .flat_map(|at| (0..windows).map(move |first| (at, first)))
            .map(|(at, first)| mean(at, first))
            .collect()
    } else {
        (0..windows)
            .flat_map(|first| (0..across).map(move |at| (at, first)))
            .map(|(at, first)| mean(at, first))
            .collect()
    }
}

/// SSIM of a window. Partial windows can give negative variances and covariances above the geometric mean of the
/// variances, so both are clamped.
fn ssim_of_moments([a, b, squares_a, squares_b, products]: [f64; 5]) -> f64 {
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

    /// Values of an independent implementation; its SSIM agrees with DyCheck's own code to 1e-15.
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
            (mask(ellipse), 0.9591076176376552, 0.9419299871228156),
            (mask(|x, y| !ellipse(x, y)), 0.9336555063876315, 0.9254850022481774),
            (mask(|x, y| x < 5 && y < 4), 0.9999455931516781, 0.9944178573621729),
            (mask(|_, _| true), 0.8770442945649521, 0.8770442945649521),
        ] {
            let found = masked_ssim(&a, &b, &mask);
            near(&found.dycheck, dycheck);
            near(&found.strict, strict);
        }
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
