//! Noise over seeds: marks, significant differences, ties and budgets.

use insta::assert_snapshot;

use super::content::{section, text};
use super::*;

/// Two methods on one scene with three seeds each and these PSNRs.
fn three_seeds(a: [f64; 3], b: [f64; 3]) -> Report {
    let runs = |method, values: [f64; 3]| (0..).zip(values).map(move |(seed, psnr)| run("trex", method, seed, psnr));
    report(runs("static3dgs", a).chain(runs("deformable4dgs", b)).collect())
}

#[test]
fn values_within_noise_of_the_best_are_marked() {
    let close = three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]);
    let cell = |report: &Report, row: usize| report.groups[0].rows[row].headline[&Column::PSNR].clone();
    assert!(cell(&close, 0).within_noise && !cell(&close, 1).within_noise, "the best is not marked");
    assert_eq!([0, 1].map(|row| cell(&close, row).rank), [Some(2), Some(1)], "ranks stay those of rounded values");
    assert_snapshot!(section(&close, "results"));
    let apart = three_seeds([30.0, 30.1, 30.2], [33.0, 33.1, 33.2]);
    assert!(!cell(&apart, 0).within_noise);
    assert!(!text(&apart).contains('≈'));
}

#[test]
fn summary_states_the_smallest_significant_difference() {
    // Standard deviation 0.5 in both: 2.776 · 0.5 · √(2/3) = 1.13 dB.
    let text = text(&three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]));
    assert!(text.contains("differences in mean PSNR below 1.13 dB are not significant"), "{text}");
    let alone = super::content::text(&report(vec![run("trex", "static3dgs", 0, 30.0)]));
    assert!(alone.contains("one seed per run, so the noise is unknown"), "{alone}");
}

#[test]
fn gains_over_the_baseline_are_counted() {
    let with_baseline = text(&report(two_by_two()));
    assert!(with_baseline.contains("| deformable4dgs | +15.50 | +10.00 | 2 of 2 |"), "{with_baseline}");
    assert!(!with_baseline.contains("with the baseline"), "{with_baseline}");
    let without = text(&report(["scgs", "mcgs"].map(|method| run("trex", method, 0, 30.0)).to_vec()));
    assert!(without.contains("with the baseline: no run of static3dgs was measured"), "{without}");
}

#[test]
fn statistical_ties_with_the_best_are_listed() {
    let close = text(&three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]));
    let tied = "highest PSNR: deformable4dgs (30.90 dB; within noise: static3dgs 30.50); \
                shortest training: static3dgs (130.5 s; within noise: deformable4dgs 130.9);";
    assert!(close.contains(tied), "{close}");
    let apart = text(&three_seeds([30.0, 30.1, 30.2], [33.0, 33.1, 33.2]));
    assert!(
        apart.contains("highest PSNR: deformable4dgs (33.10 dB); shortest training: static3dgs (130.1 s);"),
        "{apart}"
    );
    // A lead below the limit that the summary states is a tie, even if these two rows alone have a smaller spread.
    let noisy = (0..3).map(|seed| run("trex", "scgs", seed, 20.0 + 5.0 * f64::from(seed)));
    let pair = [("static3dgs", 30.0), ("deformable4dgs", 31.0)];
    let pair = pair
        .into_iter()
        .flat_map(|(method, psnr)| (0..3).map(move |seed| run("trex", method, seed, psnr + 0.01 * f64::from(seed))));
    let text = text(&report(pair.chain(noisy).collect()));
    assert!(
        text.contains("highest PSNR: deformable4dgs (31.01 dB; within noise: static3dgs 30.01, scgs 25.00)"),
        "{text}"
    );
}

#[test]
fn exceeded_budgets_are_reported() {
    let within = |secs| Run { schedule_scale: Some(1e-6), budget_secs: Some(secs), ..run("trex", "mcgs", 0, 30.0) };
    let text = |secs| text(&report(vec![within(secs)]));
    assert!(text(120.0).contains("schedule scaled by 1.0e-6, to fit a budget of 120 s (all"), "{}", text(120.0));
    assert!(text(100.0).contains("to fit a budget of 100 s (exceeded: 130.0 s) (all"), "{}", text(100.0));
}
