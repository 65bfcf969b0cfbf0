//! Noise over seeds: marks, significant differences, ties and budgets.

use std::collections::BTreeSet;

use insta::assert_snapshot;

use super::content::{document, section, text};
use super::*;
use crate::difference::Difference;
use crate::document::Block;

/// PSNRs of two methods whose difference is noise.
const CLOSE: [[f64; 3]; 2] = [[30.0, 30.5, 31.0], [31.0, 30.9, 30.0]];

/// Two methods on one scene with three seeds each and these PSNRs.
fn three_seeds(a: [f64; 3], b: [f64; 3]) -> Report {
    let runs = |method, values: [f64; 3]| (0..).zip(values).map(move |(seed, psnr)| run("trex", method, seed, psnr));
    report(runs("static3dgs", a).chain(runs("deformable4dgs", b)).collect())
}

#[test]
fn values_within_noise_of_the_best_are_marked() {
    let close = three_seeds(CLOSE[0], CLOSE[1]);
    let cell = |report: &Report, row: usize| report.groups[0].rows[row].headline[&Column::PSNR].clone();
    assert!(cell(&close, 0).within_noise && !cell(&close, 1).within_noise, "the best is not marked");
    assert_eq!([0, 1].map(|row| cell(&close, row).rank), [Some(2), Some(1)], "ranks stay those of rounded values");
    assert_snapshot!(section(&close, "results"));
    // A constant difference is no noise, however large the spread over seeds.
    let apart = three_seeds([30.0, 30.5, 31.0], [30.4, 30.9, 31.4]);
    assert!(!cell(&apart, 0).within_noise);
    assert!(!text(&three_seeds([30.0, 30.1, 30.2], [33.0, 33.1, 33.2])).contains('≈'));
}

#[test]
fn summary_states_the_precision_of_differences() {
    // Differences −1, 0.4 and 1: standard deviation 1.03, so 4.303 · 1.03 / √3 = 2.55 dB.
    let text = text(&three_seeds(CLOSE[0], CLOSE[1]));
    assert!(
        text.contains("With 3 seeds, paired differences in mean PSNR from the best method are known to ± 2.55 dB"),
        "{text}"
    );
    let summary = |runs: Vec<Run>| section(&report(runs), "summary");
    let alone = summary(vec![run("trex", "static3dgs", 0, 30.0), run("trex", "static3dgs", 1, 30.5)]);
    assert!(alone.contains("Protocol A has one method: nothing to compare."), "{alone}");
    assert!(summary(vec![run("trex", "static3dgs", 0, 30.0)]).contains("\n1 run: 1 finished."));
    let one_seed = summary(["scgs", "mcgs"].map(|method| run("trex", method, 0, 30.0)).to_vec());
    assert!(one_seed.contains("one seed per run, so differences between methods prove nothing."), "{one_seed}");
}

#[test]
fn differences_without_two_common_seeds_are_not_called_precise() {
    let of = |method: &str, seeds: [u32; 2], psnr: f64| {
        seeds.map(|seed| run("trex", method, seed, psnr + f64::from(seed) / 10.0)).to_vec()
    };
    let disjoint = [of("mcgs", [0, 1], 31.0), of("scgs", [1, 2], 30.0)].concat();
    let text = section(&report(disjoint.clone()), "summary");
    assert!(text.contains("Protocol A: fewer than two seeds in common with the best method"), "{text}");
    assert!(!text.contains("nothing to compare") && !text.contains("are known to"), "{text}");
    let text = section(&report([disjoint, of("static3dgs", [0, 1], 25.0)].concat()), "summary");
    assert!(text.contains("are known to ± 0.00 dB or better under protocol A (95 %). Exceptions, "), "{text}");
    assert!(text.contains("fewer than two seeds in common with the best: scgs."), "{text}");
}

#[test]
fn seconds_to_a_quality_that_some_seeds_never_reach_have_no_rank() {
    // Only seed 1 of static3dgs reaches 30 dB, and faster than any seed of the others.
    let mut runs = Vec::new();
    for (method, psnr) in [("static3dgs", [29.0, 60.0]), ("mcgs", [36.0, 37.0]), ("scgs", [33.0, 33.5])] {
        runs.extend((0..2).zip(psnr).map(|(seed, psnr)| run("trex", method, seed, psnr)));
    }
    let report = report(runs);
    let cell = |row: usize| &report.groups[0].rows[row].by_scene["trex"][&Column::SecsTo30Db];
    assert_eq!([0, 1, 2].map(|row| (cell(row).n(), cell(row).rank)), [(1, None), (2, Some(1)), (2, Some(2))]);
}

#[test]
fn rows_that_lack_seeds_of_others_have_no_rank_and_are_not_on_the_front() {
    // Seed 1 is harder, so a row that has not run it yet has the highest mean.
    let values =
        [("mcgs", 0, 23.885), ("mcgs", 1, 22.78), ("static3dgs", 0, 23.5), ("static3dgs", 1, 22.5), ("scgs", 0, 23.94)];
    let finished = values.map(|(method, seed, psnr)| run("trex", method, seed, psnr));
    let runs: Vec<Run> = finished.into_iter().chain([failed("trex", "scgs", 1, FailureKind::Interrupted)]).collect();
    let partial = report(runs.clone());
    for cells in partial.groups[0].rows.iter().map(|row| [&row.headline, &row.by_scene["trex"]]) {
        let [mean, scene] = cells.map(|cells| cells[&Column::PSNR].rank);
        assert_eq!(mean, scene);
    }
    let ranks = |report: &Report| -> Vec<(String, Option<usize>)> {
        report.groups[0].rows.iter().map(|row| (row.name.clone(), row.headline[&Column::PSNR].rank)).collect()
    };
    let expected = [("mcgs", Some(1)), ("static3dgs", Some(2)), ("scgs", None)];
    assert_eq!(ranks(&partial), expected.map(|(name, rank)| (name.to_owned(), rank)));
    let summary = section(&partial, "summary");
    assert!(summary.contains("highest PSNR: mcgs (23.33 dB"), "{summary}");
    assert!(summary.contains("Not ranked, because others have more seeds: scgs (1 of 2 seeds)."), "{summary}");
    let front = section(&partial, "pareto");
    assert!(front.contains("| scgs | 23.94 | 123.9 | 50.0 | no | no |"), "{front}");
    // Once all rows have equal seeds, all have ranks.
    let whole = report(runs.into_iter().filter(|run| run.seed == "0").collect());
    let expected = [("mcgs", Some(2)), ("static3dgs", Some(3)), ("scgs", Some(1))];
    assert_eq!(ranks(&whole), expected.map(|(name, rank)| (name.to_owned(), rank)));
    assert!(!section(&whole, "summary").contains("Not ranked"));
    assert!(section(&whole, "pareto").contains("| scgs | 23.94 | 123.9 | 50.0 | yes | yes |"));
}

#[test]
fn rows_with_other_seeds_than_the_ranked_ones_are_named() {
    let of = |method: &str, seeds: [u32; 2], psnr: f64| seeds.map(|seed| run("trex", method, seed, psnr)).to_vec();
    let runs = [of("mcgs", [0, 1], 31.0), of("scgs", [0, 2], 33.0), of("static3dgs", [0, 1], 25.0)].concat();
    let found = report(runs.clone());
    let ranks: Vec<_> = found.groups[0].rows.iter().map(|row| row.headline[&Column::PSNR].rank).collect();
    assert_eq!(ranks, [Some(1), None, Some(2)]);
    let summary = section(&found, "summary");
    assert!(summary.contains("Not ranked, because ranks are over the seeds 0, 1: scgs (seeds 0, 2)."), "{summary}");
    let same = runs.into_iter().filter(|run| run.row != "scgs").collect();
    assert!(!section(&report(same), "summary").contains("Not ranked"));
}

#[test]
fn marks_are_explained_below_their_tables() {
    let mut seen = BTreeSet::new();
    let document = document(&three_seeds([24.0, 30.5, 31.0], CLOSE[1]));
    for section in &document.sections {
        for block in &section.blocks {
            let Block::Table(table) = block else { continue };
            for mark in ["±", "≈", "×"] {
                let is_printed = table.rows.iter().flatten().any(|cell| cell.text.contains(&format!(" {mark}")));
                let is_explained = table.remarks.iter().any(|remark| remark.starts_with(mark));
                assert!(is_explained || !is_printed, "{mark} in {}", table.caption);
                seen.extend(is_printed.then_some((section.id, mark)));
            }
        }
    }
    for id in ["results", "budgets"] {
        assert!(["±", "≈"].into_iter().all(|mark| seen.contains(&(id, mark))), "{seen:?}");
    }
    assert!(seen.contains(&("budgets", "×")), "{seen:?}");
}

#[test]
fn gains_over_the_baseline_are_counted() {
    let with_baseline = text(&report(two_by_two()));
    assert!(
        with_baseline.contains("| deformable4dgs | +15.50 ± 0.00 | +10.00 ± 0.00 | +12.75 ± 0.00 | 2 of 2 |"),
        "{with_baseline}"
    );
    assert!(!with_baseline.contains("with the baseline"), "{with_baseline}");
    let without = text(&report(["scgs", "mcgs"].map(|method| run("trex", method, 0, 30.0)).to_vec()));
    assert!(without.contains("with the baseline: no run of static3dgs was measured"), "{without}");
}

#[test]
fn statistical_ties_with_the_best_are_listed() {
    let close = text(&three_seeds(CLOSE[0], CLOSE[1]));
    assert!(
        close.contains("highest PSNR: deformable4dgs (30.63 dB; not distinguishable with 3 seeds: static3dgs 30.50); "),
        "{close}"
    );
    let apart = text(&three_seeds([30.0, 30.1, 30.2], [33.0, 33.1, 33.2]));
    assert!(
        apart.contains("highest PSNR: deformable4dgs (33.10 dB); shortest training: static3dgs (130.1 s);"),
        "{apart}"
    );
}

#[test]
fn differences_from_bases_are_paired_by_seed() {
    let values = [("scgs", [30.0, 31.0, 32.0]), ("mcgs", [30.5, 31.4, 32.6])];
    let runs = values
        .into_iter()
        .flat_map(|(method, psnr)| (0..3_u32).zip(psnr).map(move |(seed, psnr)| run("trex", method, seed, psnr)));
    let params =
        TableGenerationParams { bases: [("mcgs".into(), "scgs".into())].into(), ..TableGenerationParams::default() };
    let report = Report::new(runs.collect(), &library::claims().expect("valid claims"), &params);
    // Differences 0.5, 0.4 and 0.6: standard deviation 0.1, so ± 4.303 · 0.1 / √3 = 0.25.
    let [difference] = &report.differences[..] else { panic!("{:?}", report.differences) };
    assert_eq!((difference.row.as_str(), difference.reference.as_str()), ("mcgs", "scgs"));
    assert_eq!(difference.psnr.text(Column::PSNR), "+0.50 ± 0.25");
    // Without the pairing by seed the spread of 1 dB would hide it.
    let mut shuffled = report.groups[0].rows[1].headline[&Column::PSNR].clone();
    shuffled.seeds.rotate_left(1);
    let base = &report.groups[0].rows[0].headline[&Column::PSNR];
    assert!(Difference::of(&shuffled, base).is_some_and(Difference::is_noise));
    let one_seed = Report::new(vec![run("trex", "scgs", 0, 30.0), run("trex", "mcgs", 0, 31.0)], &[], &params);
    assert_eq!(one_seed.differences[0].psnr.text(Column::PSNR), "+1.00");
}

#[test]
fn exceeded_budgets_are_reported() {
    let within = |secs| Run { schedule_scale: Some(1e-6), budget_secs: Some(secs), ..run("trex", "mcgs", 0, 30.0) };
    let text = |secs| text(&report(vec![within(secs)]));
    assert!(text(120.0).contains("schedule scaled by 1.0e-6, to fit a budget of 120 s (all"), "{}", text(120.0));
    assert!(text(100.0).contains("to fit a budget of 100 s (exceeded: 130.0 s) (all"), "{}", text(100.0));
}
