//! Golden values of an independent f64 implementation in NumPy and SciPy, for images from the same integer formulas. The
//! SSIM values agree with scikit-image to 1e-15.

use super::psnr::PSNR_CAP_DB;
use super::*;
use crate::tests::images::{image, noise, perturbed};

/// Tolerance against the independent implementation; both compute in f64.
pub(super) const TOLERANCE: f64 = 1e-9;

fn nearly(x: i64, y: i64, c: i64) -> i64 {
    noise(x, y, c) + (x + y + c) % 3 - 1
}

fn triangle(value: i64, period: i64) -> i64 {
    let phase = value.rem_euclid(2 * period);
    phase.min(2 * period - phase)
}

fn smooth(x: i64, y: i64, c: i64) -> i64 {
    triangle(2 * x + y + 30 * c, 160) + triangle(x + 3 * y + 50 * c, 95)
}

fn smooth_noisy(x: i64, y: i64, c: i64) -> i64 {
    triangle(2 * x + y + 30 * c + 5, 160) + triangle(x + 3 * y + 50 * c, 95) + (7 * x + 13 * y + 5 * c) % 9 - 4
}

fn scores(width: usize, height: usize, pair: [fn(i64, i64, i64) -> i64; 2]) -> BTreeMap<Metric, Score> {
    image_scores(&image(width, height, pair[0]), &image(width, height, pair[1]), &Metric::ALL.into())
}

fn assert_score(scores: &BTreeMap<Metric, Score>, metric: Metric, expected: f64) {
    let value = scores[&metric].value().expect("defined");
    assert!((value - expected).abs() <= TOLERANCE, "{} = {value}, expected {expected}", metric.key());
}

#[test]
fn generated_images_have_the_expected_sums() {
    let sum = |image: Image| image.planes.iter().flatten().map(|value| (value * 255.0).round() as u64).sum::<u64>();
    assert_eq!(sum(image(64, 48, noise)), 1_166_592);
    assert_eq!(sum(image(64, 48, perturbed)), 1_124_948);
    assert_eq!(sum(image(64, 48, nearly)), 1_166_590);
}

#[test]
fn psnr_equals_independent_values() {
    let [a, b, c] = [image(64, 48, noise), image(64, 48, perturbed), image(64, 48, nearly)];
    let (mse_ab, mse_ac) = (mean_squared_error(&a, &b), mean_squared_error(&a, &c));
    assert!((psnr_from_mse(mse_ab) - 22.732017174683882).abs() <= TOLERANCE);
    assert!((psnr_from_mse(mse_ac) - 49.91155350206765).abs() <= TOLERANCE);
    assert!((psnr_from_mse((mse_ab + mse_ac) / 2.0) - 25.734010684483174).abs() <= TOLERANCE);
    assert_eq!(psnr_from_mse(mean_squared_error(&a, &a)), PSNR_CAP_DB);
}

#[test]
fn ssim_equals_independent_values() {
    let small = scores(64, 48, [noise, perturbed]);
    assert_score(&small, Metric::Ssim, 0.9010769626555261);
    assert_score(&small, Metric::SsimValid, 0.8770442945649521);
    let large = scores(400, 400, [smooth, smooth_noisy]);
    assert_score(&large, Metric::Ssim, 0.9359948510728072);
    assert_score(&large, Metric::SsimValid, 0.9336835024897112);
}

#[test]
fn ms_ssim_equals_independent_values() {
    assert_score(&scores(256, 256, [noise, perturbed]), Metric::MsSsim, 0.9858967019036853);
    assert_score(&scores(256, 256, [smooth, smooth_noisy]), Metric::MsSsim, 0.9905789415898404);
    assert_score(&scores(201, 179, [noise, perturbed]), Metric::MsSsim, 0.985281843921101);
    assert_score(&scores(201, 179, [smooth, smooth_noisy]), Metric::MsSsim, 0.9906819182422573);
}

/// The comparator must detect the other common downsampling of odd sides: that of `tf.image.ssim_multiscale`, which repeats
/// the last row, gives 0.98526.
#[test]
fn a_wrong_variant_is_rejected() {
    let odd = scores(201, 179, [noise, perturbed]);
    let value = odd[&Metric::MsSsim].value().expect("defined");
    assert!((value - 0.9852561671548488).abs() > 1e-5);
    let small = scores(64, 48, [noise, perturbed]);
    assert!((small[&Metric::Ssim].value().expect("defined") - 0.8770442945649521).abs() > 1e-2);
}

#[test]
fn small_images_have_undefined_ssim_variants() {
    let reason = |scores: &BTreeMap<Metric, Score>, metric| scores[&metric].clone();
    let small = scores(160, 400, [noise, perturbed]);
    assert_eq!(reason(&small, Metric::MsSsim), Score::undefined("image smaller than 161 px"));
    assert!(scores(161, 400, [noise, perturbed])[&Metric::MsSsim].value().is_some());
    let tiny = scores(10, 40, [noise, perturbed]);
    assert_eq!(reason(&tiny, Metric::SsimValid), Score::undefined("image smaller than 11 px"));
    assert!(tiny[&Metric::Ssim].value().is_some());
}

#[test]
fn constant_and_identical_images_have_finite_scores() {
    let black: fn(i64, i64, i64) -> i64 = |_, _, _| 0;
    let white: fn(i64, i64, i64) -> i64 = |_, _, _| 255;
    for pair in [[black, black], [black, white], [white, white], [noise, noise]] {
        for (metric, score) in scores(200, 170, pair) {
            assert!(score.value().is_some_and(f64::is_finite), "{}", metric.key());
        }
    }
    assert_score(&scores(200, 170, [noise, noise]), Metric::MsSsim, 1.0);
    assert_score(&scores(200, 170, [black, white]), Metric::Psnr, 0.0);
}

#[test]
fn a_nan_error_is_not_a_perfect_score() {
    assert!(psnr_from_mse(f64::NAN).is_nan());
    assert_eq!(psnr_from_mse(f64::INFINITY), f64::NEG_INFINITY);
    assert_eq!(psnr_from_mse(0.0), PSNR_CAP_DB);
}
