//! Numbers and text of reports.

use engine::FailureKind;
use insta::assert_snapshot;
use metric_evaluation::{Score, TrivialOverlap};

use super::*;
use crate::cell::Cell;
use crate::claims::Verdict;
use crate::column::Masked;
use crate::difference::RowDifference;
use crate::document::Document;
use crate::markdown::markdown;
use crate::sections;

pub(super) fn document(report: &Report) -> Document {
    sections::document(report, Vec::new(), &TableGenerationParams::default()).expect("a document")
}

/// The report as Markdown.
pub(super) fn text(report: &Report) -> String {
    markdown(&document(report))
}

/// One section of the report as Markdown.
pub(super) fn section(report: &Report, id: &str) -> String {
    let mut document = document(report);
    document.sections.retain(|section| section.id == id);
    markdown(&document)
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
    assert_snapshot!(text(&report));
}

#[test]
fn ranks_follow_direction_and_rounding() {
    let report = report(two_by_two());
    assert_eq!(headline(&report, 0, Column::TrainingSecs).rank, Some(1), "lower times rank first");
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
fn fronts_need_times_of_one_machine() {
    let mut runs = two_by_two();
    let one = section(&report(runs.clone()), "pareto");
    assert!(
        one.contains("| static3dgs | 24.10 | 124.1 | 50.0 | yes | no |") && !one.contains("several kinds"),
        "{one}"
    );
    runs[0].machines = [("training".to_owned(), machine("Processor 2"))].into();
    let several = section(&report(runs), "pareto");
    assert!(several.contains("| static3dgs | 24.10 | 124.1 | 50.0 | – | – |"), "{several}");
    assert_eq!(several.matches("several kinds of machines, so there is no Pareto front").count(), 2, "{several}");
}

/// A run of a variant of `l4dgs`.
fn variant_of_l4dgs(name: &str, seed: u32, psnr: f64) -> Run {
    Run { row: format!("l4dgs ablation={name}"), variant: Some(name.into()), ..run("trex", "l4dgs", seed, psnr) }
}

#[test]
fn variants_on_different_machines_differ_in_quality_only() {
    let mut runs = vec![variant_of_l4dgs("base", 0, 30.0), variant_of_l4dgs("full", 0, 31.5)];
    runs.iter_mut().for_each(|run| drop(run.figures.insert(Column::MsPerIteration, Score::Value(4.0))));
    let table = |runs: &[Run]| section(&report(runs.to_vec()), "ablation");
    let same = table(&runs);
    assert!(same.contains("| full | 31.50 | +1.50 | 131.5 | +1.5 | 4.00 | +0.00 | 12345 | +0 | 60.00 |"), "{same}");
    runs[0].machines = [("training".to_owned(), machine("Processor 2"))].into();
    let differing = table(&runs);
    assert!(differing.contains("| full | 31.50 | +1.50 | 131.5 | – | 4.00 | – | 12345 | +0 | – |"), "{differing}");
    assert!(differing.contains("several kinds of machines, so their differences are left out"), "{differing}");
}

#[test]
fn gain_per_minute_is_over_the_common_seeds() {
    let of = |name: &str, seed: u32, psnr: f64, secs: f64| {
        let mut run = variant_of_l4dgs(name, seed, psnr);
        run.figures.insert(Column::TrainingSecs, Score::Value(secs));
        run
    };
    let runs = [("base", 0, 20.0, 100.0), ("base", 1, 30.0, 100.0), ("full", 1, 31.0, 130.0), ("full", 2, 50.0, 190.0)];
    let table = section(&report(runs.map(|(name, seed, psnr, secs)| of(name, seed, psnr, secs)).to_vec()), "ablation");
    // Seed 1 gains 1 dB in 30 s; the means over all seeds would be 15.5 dB and 60 s apart.
    let line = table.lines().find(|line| line.starts_with("| full |")).expect("a line");
    assert!(line.contains("| +1.00 |") && line.ends_with("| 2.00 |"), "{line}");
}

#[test]
fn tables_never_mix_protocols() {
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
    assert!(twice.check().is_err(), "two groups with one protocol were accepted");
}

#[test]
fn missing_scenes_leave_no_mean() {
    let mut runs = two_by_two();
    runs.retain(|run| !(run.scene == "trex" && run.row == "deformable4dgs"));
    let report = report(runs);
    assert_eq!(headline(&report, 1, Column::PSNR).mean, None);
    assert_eq!(headline(&report, 0, Column::PSNR).rank, None, "nothing to compare with");
    assert_snapshot!(section(&report, "results"));
}

#[test]
fn columns_without_any_value_are_named_with_reasons_and_scenes() {
    let mut runs = two_by_two();
    for run in runs.iter_mut().filter(|run| run.scene == "trex") {
        run.figures.insert(Column::Metric(Metric::MsSsim), Score::undefined("too small"));
        run.figures.insert(Column::FpsRaster, Score::Value(90.0));
    }
    let text = section(&report(runs), "results");
    let named = "Without any value: MS-SSIM (bouncingballs: image smaller than 161 px; trex: too small); LPIPS alex (all \
                 scenes: no weights); FPS delivered (all scenes: not measured).";
    assert!(text.contains(named), "{text}");
    assert!(text.contains("| FPS raster | FPS model | seeds |"), "a column with a value in one scene stays: {text}");
}

#[test]
fn unfinished_runs_do_not_explain_a_column_without_values() {
    let mut runs = two_by_two();
    // On trex, the other seed of the method finished.
    for (at, scene, seed) in [(1, "bouncingballs", 0), (5, "bouncingballs", 1), (3, "trex", 0)] {
        runs[at] = failed(scene, "deformable4dgs", seed, FailureKind::Crashed);
    }
    let text = section(&report(runs), "results");
    assert!(text.contains("Without any value: MS-SSIM (all scenes: image smaller than 161 px); LPIPS alex"), "{text}");
}

#[test]
fn failures_appear_in_cells_and_in_a_table() {
    let mut runs = two_by_two();
    runs[3] = failed("trex", "deformable4dgs", 0, FailureKind::Diverged);
    let one_seed = report(runs.clone());
    assert_eq!(headline(&one_seed, 1, Column::PSNR).n(), 1);
    assert_snapshot!("failure_of_one_seed", section(&one_seed, "results"));
    runs[7] = failed("trex", "deformable4dgs", 1, FailureKind::OutOfMemory);
    let none = report(runs);
    assert_eq!(headline(&none, 1, Column::PSNR).mean, None);
    assert_snapshot!("failure_of_all_seeds", section(&none, "failures"));
}

#[test]
fn missing_data_skips_scenes_but_failures_leave_holes() {
    let mut runs = two_by_two();
    for method in ["static3dgs", "deformable4dgs"] {
        runs.push(failed("lego", method, 0, FailureKind::MissingData));
    }
    let missing = report(runs.clone());
    assert_eq!(missing.groups[0].scenes, ["bouncingballs", "trex"]);
    assert!(missing.failures.is_empty());
    assert_snapshot!(section(&missing, "failures"), @r"
    # Results

    ## Failures

    **Scenes without data on this machine**

    | scene | message |
    | --- | --- |
    | lego | lego went wrong |
    ");
    assert!(headline(&missing, 0, Column::PSNR).mean.is_some());
    runs.push(Run { protocol: Some(protocol(800)), ..failed("hook", "static3dgs", 0, FailureKind::Crashed) });
    assert_eq!(
        headline(&report(runs), 0, Column::PSNR).mean,
        None,
        "a mean skipped a scene that failed for all methods"
    );
}

#[test]
fn a_failure_leaves_a_hole_under_its_own_protocol_only() {
    let mut runs: Vec<Run> = two_by_two().into_iter().filter(|run| run.seed == "0").collect();
    // At 400 px, both trainings on trex fail; at 800 px, everything finishes.
    for method in ["static3dgs", "deformable4dgs"] {
        let small = |run: Run| Run { row: format!("{method} size=400"), protocol: Some(protocol(400)), ..run };
        runs.push(small(run("bouncingballs", method, 0, 28.0)));
        runs.push(small(failed("trex", method, 0, FailureKind::BadInput)));
    }
    let found = report(runs);
    let [large, small] = &found.groups[..] else { panic!("{:?}", found.groups) };
    let names = |group: &crate::report::Group| group.rows.iter().map(|row| row.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(large), ["static3dgs", "deformable4dgs"], "no row of another protocol");
    assert_eq!(names(small), ["static3dgs size=400", "deformable4dgs size=400"]);
    assert_eq!(small.scenes, ["bouncingballs", "trex"]);
    for row in &small.rows {
        let cell = &row.headline[&Column::PSNR];
        assert_eq!((cell.mean, cell.reason.as_deref()), (None, Some("trex: bad input")), "a mean skipped a scene");
    }
}

#[test]
fn tables_never_contain_nan() {
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
fn verdicts_require_the_same_protocol() {
    // Two seeds of 33.0 and 33.2 dB do not contradict 34.23 dB: half the interval of their mean is 1.27 dB wide.
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
    assert!(
        matches!(own.entries[2], Some((_, Verdict::NotComparable))),
        "the published mean covers eight scenes, the measured one two"
    );
    assert_eq!(column(&same, "Grid4D").differences, ["checkpoint rule not stated"]);
    assert_snapshot!("verdicts_under_the_same_protocol", section(&same, "published"));

    let small = two_by_two().into_iter().map(|run| Run { protocol: Some(protocol(200)), ..run }).collect();
    let small = report(small);
    assert_snapshot!("verdicts_under_another_protocol", section(&small, "summary"));
    assert_snapshot!("reasons_under_another_protocol", section(&small, "published"));
    let entries = small.groups[0].claims.iter().flat_map(|table| &table.columns).flat_map(|column| &column.entries);
    assert!(entries.flatten().all(|(_, verdict)| *verdict == Verdict::NotComparable));
}

#[test]
fn settings_of_further_axes_have_no_verdict() {
    let with_axis = |run: Run| Run {
        row: format!("{} steps=of-phys4dgs", run.row),
        axes: [("steps".to_owned(), "of-phys4dgs".to_owned())].into(),
        ..run
    };
    let others = two_by_two().into_iter().filter(|run| run.method == "deformable4dgs").map(with_axis);
    let report = report(two_by_two().into_iter().chain(others).collect());
    let reason = "settings of further axes: steps=of-phys4dgs".to_owned();
    let table = report.groups[0].claims.iter().find(|table| table.row.ends_with("of-phys4dgs")).expect("claims");
    assert!(table.columns.iter().all(|column| column.differences.contains(&reason)), "{:?}", table.columns);
    let text = section(&report, "summary");
    assert!(text.contains("1 of 16 sources are comparable; 1 of 2 values are reproduced, 1 undecided"), "{text}");
}

#[test]
fn time_to_quality_is_the_first_evaluation_above() {
    let report = report(vec![run("trex", "static3dgs", 0, 30.0)]);
    // The curve is 30 (1 - 0.5 exp(-i)) every 20 s: above 90 % from i = 2, 95 % from i = 3, 99 % from i = 4.
    let cells = &report.groups[0].rows[0].by_scene["trex"];
    let seconds = [Column::SecsTo90, Column::SecsTo95, Column::SecsTo99].map(|column| cells[&column].mean);
    assert_eq!(seconds, [Some(40.0), Some(60.0), Some(80.0)]);
    // 25 dB lies above 30 (1 - 0.5 exp(-1)) = 24.5, so it is reached at i = 2; 30 and 35 dB never. Deadlines: 15 dB at
    // 10 s, 30 (1 - 0.5 exp(-3)) at 60 s, the end at 5 min.
    assert_snapshot!(section(&report, "budgets"));
}

#[test]
fn variants_are_compared_with_the_first() {
    let variant = |name: &str, psnr: f64| variant_of_l4dgs(name, 0, psnr);
    let ablated = report(vec![variant("base", 30.0), variant("full", 31.5), run("trex", "static3dgs", 0, 20.0)]);
    assert_snapshot!(section(&ablated, "ablation"));
    let alone = report(vec![variant("full", 31.5)]);
    let has_ablation = document(&alone).sections.iter().any(|section| section.id == "ablation");
    assert!(!has_ablation, "a single variant is no ablation");
}

#[test]
fn variants_differ_in_other_metrics_where_these_were_measured() {
    let [error, moving] = [Metric::VelocityError, Metric::PsnrMoving].map(Column::Metric);
    let mut runs = Vec::new();
    for (name, values) in [("base", [0.5, 0.6, 0.7]), ("full", [0.4, 0.49, 0.58])] {
        for (seed, value) in (0..).zip(values) {
            let mut run = variant_of_l4dgs(name, seed, 30.0);
            run.figures.extend([(error, Score::Value(value)), (moving, Score::Value(20.0 * value))]);
            // The error is undefined in this scene, so that there is no mean over scenes.
            runs.push(Run { scene: "lego".into(), ..variant_of_l4dgs(name, seed, 30.0) });
            runs.push(run);
        }
    }
    let table = section(&report(runs), "ablation");
    assert!(table.contains("| dB per extra minute | Δ velocity error (1/s) | Δ PSNR moving (dB) |"), "{table}");
    // Differences −0.10, −0.11 and −0.12: standard deviation 0.01, so ± 4.303 · 0.01 / √3 = 0.025.
    let line = table.lines().find(|line| line.starts_with("| full |")).expect("a line");
    assert!(line.ends_with("| −0.110 ± 0.025 | −2.20 ± 0.50 |"), "{line}");
    let first = table.lines().find(|line| line.starts_with("| base |")).expect("a line");
    assert!(first.ends_with("| – | – |"), "{first}");
    assert!(table.contains("an interval does not contain the spread over scenes"), "{table}");
}

#[test]
fn prompts_have_a_line_each_next_to_trivial_answers() {
    let prompted = |method: &str, seed: u32, ious: [f64; 2]| {
        let named = |values: [f64; 2]| ["ball", "arm"].map(String::from).into_iter().zip(values);
        let trivial =
            |(prompt, constant): (String, f64)| (prompt, TrivialOverlap { constant, spatial_prior: constant + 0.3 });
        let mut run = run("trex", method, seed, 30.0);
        run.prompts = named(ious).map(|(prompt, iou)| (prompt, Score::Value(iou))).collect();
        run.prompts.insert("nothing".into(), Score::undefined("no class has this name"));
        run.trivial_prompts = named([0.1, 0.5]).map(trivial).collect();
        run
    };
    let runs = vec![
        prompted("l4dgs", 0, [0.7, 0.9]),
        prompted("l4dgs", 1, [0.9, 0.9]),
        prompted("vcgs", 0, [0.4, 0.8]),
        run("trex", "scgs", 0, 30.0),
    ];
    let text = section(&report(runs.clone()), "results");
    let lines = "| scene | prompt | l4dgs | vcgs | best constant answer | spatial prior |\n\
                 | --- | --- | ---: | ---: | ---: | ---: |\n\
                 | trex | arm | 0.900 ± 0.000 | 0.800 | 0.500 | 0.800 |\n\
                 | trex | ball | 0.800 ± 0.141 | 0.400 | 0.100 | 0.400 |\n\n";
    assert!(text.contains(lines), "{text}");
    // A seed that failed is marked, as in all tables per scene.
    let mut some = runs;
    some[1] = failed("trex", "l4dgs", 1, FailureKind::Crashed);
    let text = section(&report(some), "results");
    assert!(text.contains("| trex | ball | 0.700 ×1/2 | 0.400 | 0.100 | 0.400 |"), "{text}");
}

/// A run of a method, or of a variant of it, at a value of the axis `scale`.
fn scaled(method: &str, variant: Option<&str>, scale: &str, psnr: f64) -> Run {
    let name = variant.map(|variant| format!(" ablation={variant}")).unwrap_or_default();
    Run {
        row: format!("{method}{name} scale={scale}"),
        variant: variant.map(str::to_owned),
        axes: [("scale".to_owned(), scale.to_owned())].into(),
        ..run("trex", method, 0, psnr)
    }
}

/// "ROW − REFERENCE: DIFFERENCE" for each difference of the report.
fn differences(report: &Report) -> Vec<String> {
    let text = |pair: &RowDifference| format!("{} − {}: {}", pair.row, pair.reference, pair.psnr.text(Column::PSNR));
    report.differences.iter().map(text).collect()
}

#[test]
fn rows_are_compared_at_equal_values_of_further_axes() {
    let mut runs = Vec::new();
    for (scale, gain) in [("1", 0.0), ("2", 2.0)] {
        runs.extend([scaled("static3dgs", None, scale, 20.0 + gain), scaled("mcgs", None, scale, 30.0 + 3.0 * gain)]);
    }
    let found = report(runs.clone());
    let expected = [
        "mcgs scale=1 − static3dgs scale=1: +10.00",
        "static3dgs scale=2 − static3dgs scale=1: +2.00",
        "mcgs scale=2 − static3dgs scale=2: +14.00",
    ];
    assert_eq!(differences(&found), expected);
    let table = section(&found, "results");
    assert!(table.contains("| mcgs scale=2 − static3dgs scale=2 | +14.00 | – |"), "{table}");

    let bases = [("mcgs".to_owned(), "static3dgs".to_owned())].into();
    let params = TableGenerationParams { bases, ..TableGenerationParams::default() };
    assert_eq!(differences(&Report::new(runs.clone(), &[], &params)), [expected[0], expected[2]]);

    // A baseline at one value only is compared with all rows, and the caption states its value.
    runs.retain(|run| run.row != "static3dgs scale=1");
    let one = report(runs);
    assert_eq!(differences(&one), ["mcgs scale=1 − static3dgs scale=2: +8.00", expected[2]]);
    assert!(section(&one, "results").contains("gain in PSNR over static3dgs scale=2 (dB)"));
}

/// A run of `deformable4dgs` with a further axis.
fn with_equal_steps() -> Run {
    Run {
        row: "deformable4dgs steps=equal".into(),
        axes: [("steps".to_owned(), "equal".to_owned())].into(),
        ..run("trex", "deformable4dgs", 0, 31.0)
    }
}

#[test]
fn a_row_with_an_axis_that_the_method_lacks_is_no_reference() {
    let mut runs = vec![with_equal_steps(), run("trex", "l4dgs", 0, 33.0)];
    let based = TableGenerationParams {
        bases: [("l4dgs".to_owned(), "deformable4dgs".to_owned())].into(),
        ..TableGenerationParams::default()
    };
    let on_baseline = TableGenerationParams { baseline: "deformable4dgs".into(), ..TableGenerationParams::default() };
    let report = |runs: &[Run], params: &TableGenerationParams| Report::new(runs.to_vec(), &[], params);
    for params in [&based, &on_baseline] {
        assert_eq!(differences(&report(&runs, params)), Vec::<String>::new());
    }
    let document = sections::document(&report(&runs, &based), Vec::new(), &based).expect("a document");
    let note = "No comparison with the base of l4dgs: no run of deformable4dgs without further axes was measured";
    assert!(markdown(&document).contains(note), "{}", markdown(&document));

    runs.push(run("trex", "deformable4dgs", 0, 30.0));
    let gain = "l4dgs − deformable4dgs: +3.00";
    assert_eq!(differences(&report(&runs, &based)), [gain]);
    let of_steps = "deformable4dgs steps=equal − deformable4dgs: +1.00";
    assert_eq!(differences(&report(&runs, &on_baseline)), [of_steps, gain]);
}

#[test]
fn a_base_may_name_values_of_further_axes() {
    let mut runs = vec![run("trex", "deformable4dgs", 0, 30.0), with_equal_steps(), run("trex", "phys4dgs", 0, 33.0)];
    let params = |base: &str| TableGenerationParams {
        bases: [("phys4dgs".to_owned(), base.to_owned())].into(),
        ..TableGenerationParams::default()
    };
    let found = |base: &str, runs: &[Run]| differences(&Report::new(runs.to_vec(), &[], &params(base)));
    assert_eq!(found("deformable4dgs", &runs), ["phys4dgs − deformable4dgs: +3.00"]);
    let of_equal = "deformable4dgs steps=equal";
    assert_eq!(found(of_equal, &runs), ["phys4dgs − deformable4dgs steps=equal: +2.00"]);

    runs.remove(1);
    assert_eq!(found(of_equal, &runs), Vec::<String>::new(), "another row is not the base");
    let report = Report::new(runs, &[], &params(of_equal));
    let text = markdown(&sections::document(&report, Vec::new(), &params(of_equal)).expect("a document"));
    let note = "No comparison with the base of phys4dgs: no run of deformable4dgs steps=equal was measured";
    assert!(text.contains(note), "{text}");

    let problems = |base: &str| {
        let problems = params(base).problems().into_iter();
        problems.map(|problem| format!("{}: {}", problem.key, problem.message)).collect::<Vec<_>>()
    };
    assert_eq!(problems(of_equal), Vec::<String>::new());
    let malformed =
        ["deformable4dgs equal", "deformable4dgs steps=", "steps=equal"].map(|base| problems(base).concat());
    let expected = [
        "bases.phys4dgs: `equal` is not a value of an axis",
        "bases.phys4dgs: `steps=` is not a value of an axis",
        "bases.phys4dgs: `steps=equal` does not begin with a method",
    ];
    assert_eq!(malformed, expected);
}

#[test]
fn variants_are_compared_at_equal_values_of_further_axes() {
    let variants = [("full", "1", 30.0), ("full", "2", 31.0), ("lean", "1", 29.0), ("lean", "2", 28.0)];
    let found = report(variants.map(|(variant, scale, psnr)| scaled("mcgs", Some(variant), scale, psnr)).to_vec());
    let expected = [
        "mcgs ablation=full scale=2 − mcgs ablation=full scale=1: +1.00",
        "mcgs ablation=lean scale=1 − mcgs ablation=full scale=1: −1.00",
        "mcgs ablation=lean scale=2 − mcgs ablation=full scale=2: −3.00",
    ];
    assert_eq!(differences(&found), expected);
    let tables = section(&found, "ablation");
    assert_eq!(tables.matches("ablation of mcgs, differences from full scale=").count(), 2, "{tables}");
    assert!(tables.contains("| lean scale=2 | 28.00 | −3.00 |"), "{tables}");
}

/// A run of an axis of left-out parts on `trex`, of the whole training or of one without `part`.
fn without(method: &str, part: Option<&str>, psnr: f64) -> Run {
    Run {
        row: format!("{method} without={}", part.unwrap_or("nothing")),
        variant: Some(part.map_or("whole".into(), |part| format!("without {part}"))),
        ..run("trex", method, 0, psnr)
    }
}

#[test]
fn whole_trainings_of_an_axis_of_parts_have_gains_and_published_values() {
    let runs = vec![without("static3dgs", None, 25.0), without("deformable4dgs", None, 33.0)];
    let found = report(runs.clone());
    assert_eq!(differences(&found), ["deformable4dgs without=nothing − static3dgs without=nothing: +8.00"]);
    assert!(section(&found, "results").contains("gain in PSNR over static3dgs without=nothing (dB)"));
    let tables = |report: &Report| report.groups[0].claims.iter().map(|table| table.row.clone()).collect::<Vec<_>>();
    assert!(tables(&found).contains(&"deformable4dgs without=nothing".to_owned()), "{:?}", tables(&found));
    let bases = [("deformable4dgs".to_owned(), "static3dgs".to_owned())].into();
    let params = TableGenerationParams { bases, ..TableGenerationParams::default() };
    assert_eq!(differences(&Report::new(runs, &[], &params)), differences(&found));
    // A training without a part is neither a baseline nor the published method.
    let parts = report(vec![
        without("static3dgs", Some("motion"), 25.0),
        without("deformable4dgs", None, 33.0),
        without("deformable4dgs", Some("motion"), 30.0),
    ]);
    assert_eq!(differences(&parts), ["deformable4dgs without=motion − deformable4dgs without=nothing: −3.00"]);
    assert!(!tables(&parts).contains(&"deformable4dgs without=motion".to_owned()), "{:?}", tables(&parts));
}

#[test]
fn conditional_metrics_list_only_their_scenes() {
    let mut moving = run("trex", "phys4dgs", 0, 30.0);
    moving.figures.insert(Column::Metric(Metric::VelocityError), Score::Value(0.125));
    let foreground = Column::Masked(Masked { metric: Metric::MaskedPsnr, mask: MaskName::Foreground });
    moving.figures.insert(foreground, Score::Value(24.5));
    moving.figures.insert(Column::Metric(Metric::PsnrMoving), Score::Value(21.5));
    let mut still = run("lego", "phys4dgs", 0, 30.0);
    still.figures.insert(Column::Metric(Metric::VelocityError), Score::undefined("nothing moves in the image"));
    assert_snapshot!(section(&report(vec![moving, still]), "results"));
}

#[test]
fn unimported_scenes_are_named_and_take_no_mean() {
    let mut runs = two_by_two();
    runs.retain(|run| run.seed == "0");
    runs[2].protocol = Some(protocol(400));
    runs[3].protocol = Some(protocol(400));
    runs.extend(["static3dgs", "deformable4dgs"].map(|method| failed("lego", method, 0, FailureKind::BadInput)));
    let of_two_protocols = report(runs.clone());
    let scenes = of_two_protocols.groups.iter().map(|group| group.scenes.clone());
    assert_eq!(scenes.collect::<Vec<_>>(), [["bouncingballs"], ["trex"]]);
    assert!(headline(&of_two_protocols, 0, Column::PSNR).mean.is_some());
    assert_snapshot!(section(&of_two_protocols, "results"));
    // Once the scene is imported and every training fails, no mean of its protocol may skip it.
    runs[4].protocol = Some(protocol(400));
    let trained_nowhere = report(runs);
    let scenes = trained_nowhere.groups.iter().map(|group| group.scenes.clone());
    assert_eq!(scenes.collect::<Vec<_>>(), [vec!["bouncingballs"], vec!["trex", "lego"]]);
    assert_eq!(trained_nowhere.groups[1].rows[0].headline[&Column::PSNR].mean, None);
}
