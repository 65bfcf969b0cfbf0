//! What several seeds allow to say.

use super::content::text;
use super::*;

/// Three seeds of two methods on one scene, with the given PSNRs.
fn three_seeds(a: [f64; 3], b: [f64; 3]) -> Report {
    let runs = |method, values: [f64; 3]| (0..).zip(values).map(move |(seed, psnr)| run("trex", method, seed, psnr));
    report(runs("static3dgs", a).chain(runs("deformable4dgs", b)).collect())
}

#[test]
fn values_that_the_spread_does_not_tell_from_the_best_are_marked() {
    let close = three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]);
    let cell = |report: &Report, row: usize| report.groups[0].rows[row].headline[&Column::PSNR].clone();
    assert!(cell(&close, 0).within_noise && !cell(&close, 1).within_noise, "the best is not marked");
    assert_eq!([0, 1].map(|row| cell(&close, row).rank), [Some(2), Some(1)], "ranks stay those of rounded values");
    assert!(text(&close).contains("| static3dgs | 30.50 ± 0.50 ≈ |"), "{}", text(&close));
    assert!(text(&close).contains("≈ within noise: the 95 % interval (Welch)"), "{}", text(&close));
    let apart = three_seeds([30.0, 30.1, 30.2], [33.0, 33.1, 33.2]);
    assert!(!cell(&apart, 0).within_noise);
    assert!(!text(&apart).contains('≈'));
}

#[test]
fn the_smallest_difference_that_counts_is_stated() {
    // Standard deviation 0.5 in both: 2.776 · 0.5 · √(2/3) = 1.13 dB.
    let text = text(&three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]));
    assert!(text.contains("whose mean PSNR differs by less than 1.13 dB cannot be told apart"), "{text}");
    let alone = super::content::text(&report(vec![run("trex", "static3dgs", 0, 30.0)]));
    assert!(alone.contains("one seed per run: nothing is known about noise"), "{alone}");
}

#[test]
fn gains_over_the_baseline_are_counted() {
    let text = text(&report(two_by_two()));
    assert!(text.contains("| deformable4dgs | +15.50 | +10.00 | 2 of 2 |"), "{text}");
}
