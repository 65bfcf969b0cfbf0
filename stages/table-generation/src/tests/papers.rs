//! Tables of papers next to measurements: shape, verdicts, missing data.

use metric_evaluation::MaskName;

use super::content::text;
use super::*;
use crate::claims::Verdict;
use crate::column::Masked;
use crate::document::{Block, Table};
use crate::papers::Measured;

const SCENES: [&str; 8] = ["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex"];

/// Runs of MCGS and SC-GS on a black background at 800 px, with the schedule scaled by `scale`.
fn runs(scenes: &[&str], scale: f64) -> Vec<Run> {
    let mut runs = Vec::new();
    for scene in scenes {
        for (method, psnr) in [("scgs", 41.6), ("mcgs", 42.7)] {
            let protocol = Protocol { background: "black".into(), ..protocol(800) };
            runs.push(Run { protocol: Some(protocol), schedule_scale: Some(scale), ..run(scene, method, 0, psnr) });
        }
    }
    runs
}

fn tables(runs: Vec<Run>, papers: &[&str]) -> Vec<Table> {
    let params = TableGenerationParams { papers: papers.iter().map(|p| (*p).into()).collect(), ..Default::default() };
    let report = Report::new(runs, &library::claims().expect("valid claims"), &params);
    let document = crate::sections::document(&report, Vec::new(), &params).expect("a document");
    let section = document.sections.into_iter().find(|section| section.id == "papers").expect("the papers");
    let table = |block| match block {
        Block::Table(table) => Some(table),
        _ => None,
    };
    section.blocks.into_iter().filter_map(table).collect()
}

fn row<'a>(table: &'a Table, label: &str, beside: Option<&str>) -> Vec<&'a str> {
    let texts = |row: &'a Vec<crate::document::Text>| row.iter().map(|cell| cell.text.as_str()).collect::<Vec<_>>();
    let is_it = |row: &Vec<&str>| row[0] == label && beside.is_none_or(|beside| row[1] == beside);
    table.rows.iter().map(texts).find(is_it).expect("the row")
}

#[test]
fn tables_keep_their_shape_and_gain_columns() {
    let tables = tables(runs(&SCENES, 1.0), &["mcgs"]);
    let first = &tables[0];
    assert!(first.caption.starts_with("Table 1 of MCGS: D-NeRF"));
    let groups: Vec<&str> = first.groups.iter().map(|(text, _)| text.as_str()).collect();
    assert_eq!(groups, ["", "PSNR", "SSIM", "LPIPS"]);
    assert_eq!(first.header[..5], ["", "published", "measured", "verdict", "re-measured"]);
    let labels: Vec<&str> = first.rows.iter().map(|row| row[0].text.as_str()).collect();
    assert_eq!(labels, ["D-NeRF", "K-Planes", "TiNeuVox", "FF-NVS", "D-3D-GS", "4D-GS", "SP-GS", "SC-GS", "Ours"]);
    assert_eq!(row(first, "D-NeRF", None)[1..3], ["31.69", ""], "a method outside this project");
    assert_eq!(row(first, "4D-GS", None)[1..3], ["35.34", "not run"]);
    let ours = row(first, "Ours", None);
    assert_eq!(ours[1..3], ["42.74", "42.70"]);
    assert!(ours[3].starts_with("not comparable ("), "{ours:?}");
    assert!(
        first.notes.iter().any(|note| note
            == "not comparable: background not stated; checkpoint rule not stated; 8-bit or float not stated"),
        "{:?}",
        first.notes
    );
    assert!(row(first, "SC-GS", None)[4].starts_with("41.65 ("), "the value of Grid4D");
    assert!(first.remarks.iter().any(|remark| remark.contains("resolutions are mixed")));
}

#[test]
fn shortened_schedules_and_other_sizes_are_named() {
    let notes = |runs| tables(runs, &["mcgs"])[0].notes.join("\n");
    assert!(notes(runs(&SCENES, 0.25)).contains("schedule scaled by 0.25"));
    assert!(!notes(runs(&SCENES, 1.0)).contains("schedule"));
    let small = runs(&SCENES, 1.0).into_iter().map(|run| Run { protocol: Some(protocol(200)), ..run }).collect();
    assert!(notes(small).contains("resolution: published 800×800, measured 200×200"));
    // A shortened schedule is no reproduction in the table of claims either.
    let mut short = two_by_two();
    short.iter_mut().for_each(|run| run.schedule_scale = Some(0.05));
    let short = report(short);
    assert!(text(&short).contains("not comparable: schedule scaled by 0.05"), "{}", text(&short));
    assert!(text(&report(two_by_two())).contains("of 2 reproduced"), "{}", text(&report(two_by_two())));
}

#[test]
fn cells_show_the_row_with_the_fewest_differences() {
    let like = |run: Run, psnr: f64| {
        let figures = [(Column::PSNR, Score::Value(psnr))].into();
        Run { figures, ..run }
    };
    let small = |run: Run| Run { protocol: Some(protocol(200)), ..like(run, 30.0) };
    let with_axis = |run: Run| Run {
        row: format!("{} steps=few", run.row),
        axes: [("steps".to_owned(), "few".to_owned())].into(),
        ..like(run, 35.0)
    };
    let all = || runs(&SCENES, 1.0).into_iter();
    let measured = |runs: Vec<Run>| row(&tables(runs, &["mcgs"])[0], "Ours", None)[2].to_owned();
    assert_eq!(measured(all().map(small).chain(all()).collect()), "42.70", "the size of the paper");
    assert_eq!(measured(all().map(with_axis).chain(all()).collect()), "42.70", "the settings of the paper");
    let alone = tables(all().map(with_axis).collect(), &["mcgs"]).remove(0);
    assert!(alone.notes.iter().any(|note| note.ends_with("settings of further axes: steps=few")), "{:?}", alone.notes);
}

#[test]
fn measured_variants_of_lpips_are_named() {
    let with_lpips = |mut run: Run| {
        run.figures.insert(Column::Metric(Metric::LpipsVgg), Score::Value(0.05));
        run
    };
    let names_variant = |runs: Vec<Run>| {
        let remarks = tables(runs, &["mcgs"]).remove(0).remarks;
        remarks.iter().filter(|remark| remark.starts_with("Measured LPIPS: VGG, input in [-1, 1].")).count()
    };
    assert_eq!(names_variant(runs(&SCENES, 1.0).into_iter().map(with_lpips).collect()), 1);
    assert_eq!(names_variant(runs(&SCENES, 1.0)), 0, "nothing was measured");
    let mask = MaskName::CoVisibility;
    let column = Column::Masked(Masked { metric: Metric::MaskedLpips, mask });
    let mut masked = masked_runs(&[]);
    masked.iter_mut().for_each(|run| drop(run.figures.insert(column, Score::Value(0.3))));
    let remarks = &tables(masked, &["kineticgs"])[1].remarks;
    assert!(
        remarks.iter().any(|remark| remark == "Measured LPIPS over a mask: AlexNet, input in [-1, 1]."),
        "{remarks:?}"
    );
}

/// A paper that prints the mean over two scenes, which is neither over all scenes of a group nor a known part of them.
const TWO_SCENES: &str = r#"
name = "Paper"
title = "Paper"
[[table]]
number = "Table 1"
caption = "mean over two scenes"
protocol = { dataset = "dnerf", split = "official", width = 800, height = 800, background = "white", checkpoint = "last", levels = "8-bit" }
scenes = ["hook", "trex"]
columns = [{ label = "PSNR", quantity = "psnr" }]
rows = [{ label = "Ours", method = "mcgs", values = "31.00" }]
"#;

#[test]
fn verdicts_on_means_over_some_scenes_know_the_spread_over_seeds() {
    let table = crate::papers::Paper::parse(TWO_SCENES).expect("a paper").tables.remove(0);
    let compared = |runs: Vec<Run>| {
        let report = report(runs);
        let (row, column) = (&table.rows[0], &table.columns[0]);
        let cell = table.compared((row, column), "31.00", &report, &[], 0.3);
        let Some(Measured::Value { value, .. }) = cell.measured else { panic!("not measured") };
        (value, cell.verdict.expect("a verdict").0)
    };
    let scenes = ["hook", "trex", "mutant"];
    let seeds = (0..3).zip([29.0, 30.0, 31.0]);
    let all = || seeds.clone().flat_map(|(seed, psnr)| scenes.map(|scene| run(scene, "mcgs", seed, psnr)));
    // The interval of the mean of 29, 30 and 31 dB is 4.303 · 1 / √3 = 2.48 dB wide to either side.
    assert_eq!(compared(all().collect()), (30.0, Verdict::WithinSpread { delta_db: -1.0 }));
    // A seed that lacks a scene is in no mean; the mean of the scenes' means would be 30.5 dB.
    let lacking = all().filter(|run| run.scene != "trex" || run.seed == "2");
    assert_eq!(compared(lacking.collect()), (31.0, Verdict::Reproduced { delta_db: 0.0 }));
}

#[test]
fn missing_data_fills_cells_without_failing() {
    let nothing: Vec<Run> = SCENES.iter().map(|scene| failed(scene, "mcgs", 0, FailureKind::MissingData)).collect();
    let all = tables(nothing, &["mcgs", "vcgs", "l4dgs", "phys4dgs", "kineticgs"]);
    assert_eq!(all.len(), 5 + 1 + 3 + 11 + 4, "all tables of all papers");
    assert_eq!(row(&all[0], "Ours", None)[1..4], ["42.74", "missing data", "not measured"]);
    assert_eq!(row(&all[0], "Ours", None)[5..7], [".998", "missing data"]);
    let mut some = runs(&SCENES[..5], 1.0);
    some.extend(SCENES[5..].iter().map(|scene| failed(scene, "mcgs", 0, FailureKind::MissingData)));
    let table = &tables(some, &["mcgs"])[0];
    assert_eq!(row(table, "Ours", None)[2], "– (a)");
    assert_eq!(table.notes[0], "missing data (3 of 7 scenes)");
}

#[test]
fn wide_tables_use_lines_instead_of_columns() {
    let table = tables(runs(&SCENES, 1.0), &["phys4dgs"]).remove(5);
    assert!(table.caption.starts_with("Table 6 of Phys4DGS"), "{}", table.caption);
    assert_eq!(table.header[2..5], ["T-Rex", "Jumping Jacks", "Hell Warrior"]);
    assert_eq!(row(&table, "Ours", Some("published"))[2], "39.13");
    assert_eq!(row(&table, "Ours", Some("measured"))[2], "not run");
    assert!(row(&table, "Deformable4DGS", Some("re-measured"))[2].starts_with("33.95 ("), "{:?}", table.rows);
}

#[test]
fn means_with_and_without_lego_are_printed() {
    let report = report(runs(&SCENES, 1.0));
    let text = text(&report);
    assert!(text.contains("| mean of 8 | mean of 7 (without lego) |"), "{text}");
    assert!(text.contains("means over 8 scenes") && text.contains("means over 7 scenes (without lego)"), "{text}");
    let table = report.groups[0].claims.iter().find(|table| table.row == "mcgs").expect("claims");
    assert_eq!(table.lines[8..], ["mean of 8", "mean of 7 (without lego)"]);
    let paper = table.columns.iter().find(|column| column.claim.source == "Table 1 of MCGS").expect("the paper");
    assert!(
        paper.entries[8].is_none() && paper.entries[9].is_some(),
        "a published mean over seven scenes belongs beside the measured mean over seven"
    );
}

#[test]
fn variants_are_found_by_their_axis() {
    let mut runs = runs(&SCENES, 1.0);
    for scene in SCENES {
        let row = "mcgs ablation=without-noise".to_owned();
        let protocol = Protocol { background: "black".into(), ..protocol(800) };
        let variant = Some("without-noise".to_owned());
        runs.push(Run { row, variant, protocol: Some(protocol), ..run(scene, "mcgs", 0, 41.5) });
    }
    let table = tables(runs, &["mcgs"]).remove(4);
    assert_eq!(row(&table, "Ours w/o Noise", None)[1..3], ["41.59", "41.50"]);
    assert_eq!(
        row(&table, "Ours (Full)", None)[1..3],
        ["42.74", "42.70"],
        "the whole method stands for the full variant"
    );
    assert_eq!(row(&table, "Ours w/o Attention", None)[2], "not run");
}

#[test]
fn whole_trainings_of_an_axis_of_parts_stand_for_the_method() {
    let mut runs = runs(&SCENES, 1.0);
    for run in &mut runs {
        (run.variant, run.row) = (Some("whole".into()), format!("{} without=nothing", run.method));
    }
    let all = tables(runs, &["mcgs"]);
    assert_eq!(row(&all[0], "Ours", None)[1..3], ["42.74", "42.70"]);
    assert_eq!(row(&all[4], "Ours (Full)", None)[1..3], ["42.74", "42.70"]);
    assert_eq!(row(&all[4], "Ours w/o Noise", None)[2], "not run", "a variant that leaves something out");
}

/// Runs of two methods on all scenes of DyCheck with the given masked PSNR of every mask.
fn masked_runs(of_masks: &[(MaskName, Score)]) -> Vec<Run> {
    let scenes = ["apple", "block", "paper-windmill", "space-out", "spin", "teddy", "wheel"];
    let of_scene = |scene: &&str| {
        let mut run = run(scene, "kineticgs", 0, 20.0);
        run.protocol = Some(Protocol { dataset: "dycheck".into(), ..protocol(360) });
        for (mask, score) in of_masks {
            run.figures.insert(Column::Masked(Masked { metric: Metric::MaskedPsnr, mask: *mask }), score.clone());
        }
        run
    };
    scenes.iter().map(of_scene).collect()
}

/// The measured mPSNR over all scenes in Table 1 (foreground) and Table 2 (co-visibility) of KineticGS.
fn masked_cells(of_masks: &[(MaskName, Score)]) -> [String; 2] {
    let all = tables(masked_runs(of_masks), &["kineticgs"]);
    // Table 1 is wide: a line for measured values, and one column per printed one. Its last mPSNR is the mean.
    let at = all[0].header.iter().rposition(|text| text == "mPSNR").expect("a column of means");
    let foreground = row(&all[0], "KineticGS (Ours)", Some("measured"))[at];
    // In Table 2, measured values have separate columns.
    let at = all[1].header.iter().position(|text| text == "measured").expect("a column of measured values");
    // The reason of a missing mean names a scene before it.
    [foreground, row(&all[1], "KineticGS (Ours)", None)[at]]
        .map(|cell| cell.rsplit(": ").next().expect("a part").to_owned())
}

#[test]
fn a_cell_shows_the_mask_that_its_table_names_and_no_other() {
    let (value, missing) = (Score::Value, Score::undefined("no foreground masks: u2net/apple is missing"));
    let both = [(MaskName::Foreground, value(18.25)), (MaskName::CoVisibility, value(14.5))];
    assert_eq!(masked_cells(&both), ["18.25", "14.50"]);
    assert_eq!(masked_cells(&both[..1]), ["18.25", "not measured"], "no value of another mask fills the cell");
    assert_eq!(masked_cells(&both[1..]), ["not measured", "14.50"]);
    assert_eq!(masked_cells(&[(MaskName::Labels, value(30.0))]), ["not measured"; 2]);
    let [foreground, co_visible] =
        masked_cells(&[(MaskName::Foreground, missing), (MaskName::CoVisibility, value(14.5))]);
    assert!(foreground.starts_with("–") && co_visible == "14.50", "{foreground} {co_visible}");
}

#[test]
fn masked_columns_survive_files_under_their_names() {
    let column = Column::Masked(Masked { metric: Metric::MaskedSsim, mask: MaskName::CoVisibility });
    assert_eq!((column.key(), column.heading().as_str()), ("masked_ssim_co_visibility", "mSSIM, co-visibility"));
    let keys: Vec<&str> = Column::all().map(Column::key).collect();
    assert_eq!(keys.iter().collect::<std::collections::BTreeSet<_>>().len(), keys.len(), "keys are unique");
    for column in Column::all() {
        let figures: std::collections::BTreeMap<Column, f64> = [(column, 1.0)].into();
        let text = serde_json::to_string(&figures).expect("written");
        assert_eq!(serde_json::from_str::<std::collections::BTreeMap<Column, f64>>(&text).expect("read"), figures);
    }
}
