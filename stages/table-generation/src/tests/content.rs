//! What the report says.

use engine::FailureKind;
use metric_evaluation::Score;

use super::*;
use crate::Verdict;
use crate::document::Document;
use crate::markdown::markdown;
use crate::report::Cell;
use crate::sections;

pub fn document(report: &Report) -> Document {
    sections::document(report, Vec::new(), &TableGenerationParams::default()).expect("a document")
}

pub fn text(report: &Report) -> String {
    markdown(&document(report))
}

fn headline(report: &Report, row: usize, column: Column) -> &Cell {
    &report.groups[0].rows[row].headline[&column]
}

#[test]
fn means_are_over_scenes_and_spread_is_over_seeds() {
    let report = report(two_by_two());
    let cell = headline(&report, 1, Column::PSNR);
    assert!((cell.mean.expect("a mean") - 36.85).abs() <= 1e-12);
    assert!((cell.std.expect("a spread") - 0.2 / 2.0_f64.sqrt()).abs() <= 1e-12);
    assert_eq!((cell.n(), cell.n_expected, cell.rank), (2, 2, Some(1)));
    let text = text(&report);
    assert!(text.contains("| deformable4dgs | **36.85 ± 0.14** |"), "{text}");
    assert!(text.contains("| static3dgs | 24.10 ± 0.14 |"), "{text}");
    assert!(text.contains("dnerf · official split · 800×800"), "{text}");
    assert!(text.contains("Means over 2 scenes (bouncingballs, trex)"), "{text}");
    assert!(text.contains("no mean: bouncingballs: image smaller than 161 px"), "{text}");
}

#[test]
fn ranks_follow_direction_and_rounding() {
    let report = report(two_by_two());
    assert_eq!(headline(&report, 0, Column::TrainingSecs).rank, Some(1), "less time is better");
    assert_eq!(headline(&report, 1, Column::TrainingSecs).rank, Some(2));
    let tied = [headline(&report, 0, Column::Gaussians), headline(&report, 1, Column::Gaussians)];
    assert_eq!(tied.map(|cell| cell.rank), [Some(1), Some(1)]);
    let near = super::report(vec![run("trex", "a", 0, 30.001), run("trex", "b", 0, 30.004)]);
    assert_eq!([0, 1].map(|row| headline(&near, row, Column::PSNR).rank), [Some(1), Some(1)]);
}

#[test]
fn times_of_different_machines_are_not_ranked() {
    let mut runs = two_by_two();
    runs[0].machines = [("training".to_owned(), machine("Processor 2"))].into();
    let report = report(runs);
    assert_eq!(headline(&report, 0, Column::TrainingSecs).rank, None);
    assert_eq!(headline(&report, 1, Column::PSNR).rank, Some(1));
}

#[test]
fn protocols_never_share_a_table() {
    let mut runs = two_by_two();
    runs[0].protocol = Some(protocol(200));
    runs[1].judged_by = Some("test images · metric version 2".into());
    let report = report(runs);
    assert_eq!(report.groups.len(), 3);
    for group in &report.groups {
        let same = |run: &&Run| {
            run.protocol.as_ref() == Some(&group.protocol) && run.judged_by.as_ref() == Some(&group.judged_by)
        };
        let cells = group.rows.iter().flat_map(|row| row.by_scene.values());
        let n_tabulated: usize = cells.map(|cells| cells[&Column::PSNR].n()).sum();
        assert_eq!(n_tabulated, report.runs.iter().filter(same).count(), "group {}", group.name);
    }
    assert_eq!(report.groups[0].scenes, ["bouncingballs"]);
    let mut twice = report.clone();
    twice.groups[0] = twice.groups[2].clone();
    assert!(twice.check().is_err(), "two groups of one protocol were accepted");
}

#[test]
fn a_missing_scene_leaves_no_mean() {
    let mut runs = two_by_two();
    runs.retain(|run| !(run.scene == "trex" && run.row == "deformable4dgs"));
    let report = report(runs);
    assert_eq!(headline(&report, 1, Column::PSNR).mean, None);
    assert_eq!(headline(&report, 0, Column::PSNR).rank, None, "nothing to compare with");
    let text = text(&report);
    assert!(text.contains("| deformable4dgs | – (d) | – (d) |"), "{text}");
    assert!(text.contains("(d) no mean: trex: not run"), "{text}");
}

#[test]
fn failures_show_in_cells_and_in_their_own_table() {
    let mut runs = two_by_two();
    runs[3] = failed("trex", "deformable4dgs", 0, FailureKind::Diverged);
    let one_seed = report(runs.clone());
    assert_eq!(headline(&one_seed, 1, Column::PSNR).n(), 1);
    assert!(text(&one_seed).contains("×1/2"), "{}", text(&one_seed));
    assert!(text(&one_seed).contains("1 of 2 seeds: trex: diverged"), "{}", text(&one_seed));
    runs[7] = failed("trex", "deformable4dgs", 1, FailureKind::OutOfMemory);
    let none = report(runs);
    assert_eq!(headline(&none, 1, Column::PSNR).mean, None);
    let text = text(&none);
    assert!(text.contains("| diverged | train/trex/deformable4dgs/0 | trex went wrong |"), "{text}");
    assert!(text.contains("| OOM | train/trex/deformable4dgs/1 | trex went wrong |"), "{text}");
}

#[test]
fn missing_data_is_reported_and_not_averaged_but_other_failures_leave_holes() {
    let mut runs = two_by_two();
    for method in ["static3dgs", "deformable4dgs"] {
        runs.push(failed("lego", method, 0, FailureKind::MissingData));
    }
    let missing = report(runs.clone());
    assert_eq!(missing.groups[0].scenes, ["bouncingballs", "trex"]);
    assert!(missing.failures.is_empty());
    assert!(text(&missing).contains("| lego | lego went wrong |"), "{}", text(&missing));
    assert!(headline(&missing, 0, Column::PSNR).mean.is_some());
    runs.push(Run { protocol: Some(protocol(800)), ..failed("hook", "static3dgs", 0, FailureKind::Crashed) });
    assert_eq!(headline(&report(runs), 0, Column::PSNR).mean, None, "a scene that failed for all was skipped");
}

#[test]
fn nan_never_reaches_a_table() {
    let mut runs = two_by_two();
    runs[0].figures.insert(Column::PSNR, Score::Value(f64::NAN));
    runs[1].figures.insert(Column::TrainingSecs, Score::Value(f64::INFINITY));
    let mut report = report(runs);
    assert_eq!(headline(&report, 0, Column::PSNR).n(), 1);
    assert!(!text(&report).contains("inf"), "{}", text(&report));
    let cell = report.groups[0].rows[0].headline.get_mut(&Column::PSNR).expect("a cell");
    cell.mean = Some(f64::NAN);
    assert!(report.check().is_err(), "NaN was accepted");
}

#[test]
fn published_values_are_judged_only_under_the_same_protocol() {
    // Two seeds of 33.0 and 33.2 dB say nothing against 34.23 dB: the interval of their mean is 1.27 dB to each side.
    let spread = report(two_by_two());
    let column = |report: &Report, source: &str| {
        let table = report.groups[0].claims.iter().find(|table| table.row == "deformable4dgs").expect("claims");
        table.columns.iter().find(|column| column.claim.source.contains(source)).expect("the source").clone()
    };
    assert!(matches!(column(&spread, "Wu et al.").entries[1], Some((_, Verdict::WithinSpread { .. }))));

    let same = report(two_by_two().into_iter().filter(|run| run.seed == "0").collect());
    let own = column(&same, "Wu et al.");
    assert!(own.differences.is_empty(), "{:?}", own.differences);
    // Measured 40.5 and 33.0 dB against printed 40.62 and 34.23 dB.
    assert!(matches!(own.entries[0], Some((_, Verdict::Reproduced { .. }))));
    assert!(matches!(own.entries[1], Some((_, Verdict::Below { delta_db })) if (delta_db + 1.23).abs() <= 1e-9));
    assert!(matches!(own.entries[2], Some((_, Verdict::NotComparable))), "a mean over eight scenes is another figure");
    assert_eq!(column(&same, "Grid4D").differences, ["checkpoint rule not stated"]);
    let text = text(&same);
    assert!(text.contains("40.62, reproduced (−0.12)"), "{text}");
    assert!(text.contains("34.23, measured below (−1.23)"), "{text}");

    let small = two_by_two().into_iter().map(|run| Run { protocol: Some(protocol(200)), ..run }).collect();
    let small = report(small);
    assert!(super::content::text(&small).contains("Not comparable because: resolution 800×800 there, 200×200 here."));
    let entries = small.groups[0].claims.iter().flat_map(|table| &table.columns).flat_map(|column| &column.entries);
    assert!(entries.flatten().all(|(_, verdict)| *verdict == Verdict::NotComparable));
}

#[test]
fn time_to_quality_is_the_first_moment_above_the_share() {
    let report = report(vec![run("trex", "static3dgs", 0, 30.0)]);
    // The curve is 30 (1 - 0.5 exp(-i)) every 20 s: above 90 % from i = 2, 95 % from i = 3, 99 % from i = 4.
    let cells = &report.groups[0].rows[0].by_scene["trex"];
    let seconds = [Column::SecsTo90, Column::SecsTo95, Column::SecsTo99].map(|column| cells[&column].mean);
    assert_eq!(seconds, [Some(40.0), Some(60.0), Some(80.0)]);
    // 25 dB lies above 30 (1 - 0.5 exp(-1)) = 24.5, so it is reached at i = 2; 30 and 35 dB never.
    let line = "| static3dgs · trex | 40.0 | 60.0 | 80.0 | 40.0 | never | never | 130.0 |";
    assert!(text(&report).contains(line), "{}", text(&report));
    // Evaluated every 20 s from 0: 15 dB at 10 s, 30 (1 - 0.5 exp(-3)) at 60 s, the end at 5 min.
    assert!(text(&report).contains("| static3dgs | 15.00 | 29.25 | 29.90 | 29.90 | 130.0 |"), "{}", text(&report));
    assert!(text(&report).contains("| method | blend | custom |"), "{}", text(&report));
}

#[test]
fn variants_are_compared_with_the_first_in_quality_and_time() {
    let variant = |name: &str, psnr: f64| {
        let mut run = run("trex", "l4dgs", 0, psnr);
        (run.row, run.variant) = (format!("l4dgs ablation={name}"), Some(name.into()));
        run
    };
    let ablated = report(vec![variant("base", 30.0), variant("full", 31.5), run("trex", "static3dgs", 0, 20.0)]);
    let text = text(&ablated);
    assert!(text.contains("ablation of l4dgs, differences to base"), "{text}");
    assert!(text.contains("| full | 31.50 | +1.50 | 131.5 | +1.5 | – | – | 60.00 |"), "{text}");
    // A method alone is no ablation.
    let alone = report(vec![variant("full", 31.5)]);
    assert!(!super::content::text(&alone).contains("ablation of"));
}

#[test]
fn figures_of_surfaces_have_a_table_over_the_scenes_that_define_them() {
    let mut moving = run("trex", "phys4dgs", 0, 30.0);
    moving.figures.insert(Column::Metric(Metric::VelocityError), Score::Value(0.125));
    let mut still = run("lego", "phys4dgs", 0, 30.0);
    still.figures.insert(Column::Metric(Metric::VelocityError), Score::undefined("nothing moves in the image"));
    let text = text(&report(vec![moving, still]));
    assert!(text.contains("velocity error (1/s) per scene (less is better)"), "{text}");
    assert!(text.contains("| method | trex |\n"), "{text}");
    assert!(text.contains("| phys4dgs | 0.125 |"), "{text}");
    assert!(!text.contains("flow error"), "{text}");
}

#[test]
fn a_scene_that_was_not_imported_is_told_once_and_takes_no_mean() {
    let mut runs = two_by_two();
    runs.retain(|run| run.seed == "0");
    runs[2].protocol = Some(protocol(400));
    runs[3].protocol = Some(protocol(400));
    runs.extend(["static3dgs", "deformable4dgs"].map(|method| failed("lego", method, 0, FailureKind::BadInput)));
    let of_two_protocols = report(runs.clone());
    let scenes = of_two_protocols.groups.iter().map(|group| group.scenes.clone());
    assert_eq!(scenes.collect::<Vec<_>>(), [["bouncingballs"], ["trex"]]);
    assert!(headline(&of_two_protocols, 0, Column::PSNR).mean.is_some());
    let said = text(&of_two_protocols);
    assert_eq!(said.matches("because nothing could be judged: lego (bad input).").count(), 1, "{said}");
    assert!(said.contains("Judged otherwise: trex (protocol B)") && said.contains("| +15.50 | 1 of 1 |"), "{said}");
    // It was imported, and then every training failed: no mean of its protocol may skip it.
    runs[4].protocol = Some(protocol(400));
    let trained_nowhere = report(runs);
    let scenes = trained_nowhere.groups.iter().map(|group| group.scenes.clone());
    assert_eq!(scenes.collect::<Vec<_>>(), [vec!["bouncingballs"], vec!["trex", "lego"]]);
    assert_eq!(trained_nowhere.groups[1].rows[0].headline[&Column::PSNR].mean, None);
}
