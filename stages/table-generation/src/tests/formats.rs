//! Every format is well formed, complete and deterministic.

use engine::Artifact;

use super::content::document;
use super::*;
use crate::artifact::ReportFolder;
use crate::document::{Block, Figure};
use crate::{csv_file, latex, svg_file};

/// A report with all kinds of content and with names that need escaping.
pub(super) fn awkward() -> Report {
    let mut runs = two_by_two();
    runs.push(run("a_b & <c>|d", "static3dgs", 0, 21.0));
    runs.push(failed("a_b & <c>|d", "deformable4dgs", 0, FailureKind::Diverged));
    runs.push(failed("lego", "static3dgs", 0, FailureKind::MissingData));
    report(runs)
}

#[test]
fn equal_reports_have_equal_bytes_and_round_trip() {
    let (first, second) = (tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder"));
    let params = TableGenerationParams::default();
    let written = ReportFolder::write(awkward(), Vec::new(), &params, first.path()).expect("written");
    ReportFolder::write(awkward(), Vec::new(), &params, second.path()).expect("written");
    let opened = ReportFolder::open(first.path()).expect("opened");
    opened.check().expect("valid");
    assert_eq!(opened, written);
    let mut n_files = 0;
    for entry in std::fs::read_dir(first.path()).expect("listed") {
        let name = entry.expect("entry").file_name();
        let read = |dir: &tempfile::TempDir| std::fs::read(dir.path().join(&name)).expect("read");
        assert_eq!(read(&first), read(&second), "{name:?}");
        n_files += 1;
    }
    assert_eq!(n_files, 6 + 4, "six texts, and the figures of pareto, curves, costs and frames");
    std::fs::remove_file(first.path().join("report.tex")).expect("removed");
    assert!(opened.check().is_err(), "a missing file was accepted");
}

#[test]
fn markdown_rows_match_their_headers() {
    let text = crate::markdown::markdown(&document(&awkward()));
    let cells = |line: &str| line.replace("\\|", "").matches('|').count();
    let lines: Vec<&str> = text.lines().collect();
    let mut n_tables = 0;
    for (i, line) in lines.iter().enumerate().filter(|(_, line)| line.starts_with("| ---")) {
        n_tables += 1;
        let rows = lines[i - 1..].iter().take_while(|row| row.starts_with('|'));
        rows.for_each(|row| assert_eq!(cells(row), cells(line), "{row}"));
    }
    assert!(n_tables >= 7, "{text}");
    assert!(text.contains("a_b & \\<c>\\|d"), "{text}");
}

#[test]
fn latex_is_balanced_and_escaped() {
    let text = latex::latex(&document(&awkward()));
    let mut environments = Vec::new();
    for (start, _) in text.match_indices("\\begin{").chain(text.match_indices("\\end{")) {
        environments.push(start);
    }
    environments.sort_unstable();
    let mut open = Vec::new();
    for start in environments {
        let name = text[start..].split(['{', '}']).nth(1).expect("a name");
        if text[start..].starts_with("\\begin") {
            open.push(name);
        } else {
            assert_eq!(open.pop(), Some(name));
        }
    }
    assert!(open.is_empty());
    let code: String = text.lines().filter(|line| !line.starts_with('%')).collect();
    let unescaped = code.replace("\\{", "").replace("\\}", "");
    assert_eq!(unescaped.matches('{').count(), unescaped.matches('}').count());
    assert!(text.contains("a\\_b \\& <c>|d") && text.contains("\\best{40.60 $\\pm$ 0.14}"), "{text}");
    assert!(text.contains("\\providecommand{\\best}"), "{text}");
    let aligned = |row: &&str| row.ends_with(" \\\\");
    assert!(text.lines().filter(aligned).count() > 10, "{text}");
}

#[test]
fn csv_parses_and_keeps_every_digit() {
    let mut runs = two_by_two();
    runs[0].figures.insert(Column::PSNR, Score::Value(1.0 / 3.0));
    runs.push(failed("lego, \"test\"", "static3dgs", 0, FailureKind::MissingData));
    runs.push(failed("hook", "static3dgs", 0, FailureKind::Interrupted));
    let text = csv_file::runs(&report(runs.clone())).expect("CSV");
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().expect("a header").clone();
    let column = |name: &str| header.iter().position(|heading| heading == name).expect("a column");
    let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().expect("parses");
    assert_eq!(rows.len(), runs.len());
    assert_eq!(rows[0][column("psnr")].parse::<f64>().expect("a number"), 1.0 / 3.0);
    assert_eq!(&rows[0][column("ms_ssim")], "");
    assert_eq!(&rows[0][column("model_key")], "0123456789ab");
    assert_eq!((&rows[8][column("scene")], &rows[8][column("outcome")]), ("lego, \"test\"", "no data"));
    assert_eq!(&rows[9][column("outcome")], "not run yet", "as `table --partial` names jobs without results");
}

#[test]
fn frames_csv_has_one_line_per_image() {
    let text = csv_file::frames(&report(two_by_two())).expect("CSV");
    assert_eq!(text.lines().count(), 1 + 8 * 4);
    assert!(text.contains("A,static3dgs,bouncingballs,0,test_2,0.5,22\n"), "{text}");
}

#[test]
fn activities_have_one_order_and_excluded_ones_are_marked() {
    let mut run = run("trex", "static3dgs", 0, 30.0);
    let activities = || ["blend", "evaluation", "load", "render"].map(|name| (name.to_owned(), 1.0)).into();
    run.phases = activities();
    run.costs.ms_per_iteration_by_phase = [("fine".to_owned(), activities())].into();
    let text = super::content::section(&report(vec![run]), "costs");
    assert!(text.contains("| method | load | blend | evaluation (excluded) | render |"), "{text}");
    assert!(text.contains("| method · phase | all | load | blend | evaluation | render |"), "{text}");
}

/// The figure with this file name.
pub(super) fn figure(report: &Report, params: &TableGenerationParams, file: &str) -> Option<Figure> {
    let document = crate::sections::document(report, Vec::new(), params).expect("a document");
    let blocks = document.sections.into_iter().flat_map(|section| section.blocks);
    blocks.into_iter().find_map(|block| match block {
        Block::Figure(figure) if figure.file == file => Some(figure),
        _ => None,
    })
}

#[test]
fn curves_have_line_number_and_band_per_method() {
    for log_time in [false, true] {
        let params = TableGenerationParams { log_time, ..Default::default() };
        let figure = figure(&report(two_by_two()), &params, "curves.svg").expect("curves");
        let titles: Vec<&str> = figure.panels.iter().map(|panel| panel.title.as_str()).collect();
        assert_eq!(titles, ["bouncingballs", "trex", "mean of 2 scenes"]);
        let labels: Vec<String> = figure.legend.iter().map(crate::document::Key::text).collect();
        assert_eq!(labels, ["1 static3dgs", "2 deformable4dgs"]);
        let text = svg_file::file(&figure);
        for part in
            ["stroke-dasharray=\"7 3\"", ">training time (s", "PSNR, validation views (dB)", ">2 deformable4dgs<"]
        {
            assert!(text.contains(part), "{part} is missing: {text}");
        }
        assert_eq!(text.matches("opacity=\"0.15\"").count(), 6, "a band per method with two seeds");
        assert!(!text.contains("NaN") && !text.contains("inf") && !text.contains('–'), "{text}");
    }
}

#[test]
fn mean_curves_pair_seeds_by_name() {
    let drawn = |runs: Vec<Run>| {
        let figure = figure(&report(runs), &TableGenerationParams::default(), "curves.svg");
        svg_file::file(&figure.expect("curves"))
    };
    let mut runs = two_by_two();
    let in_order = drawn(runs.clone());
    // The runs on trex: seed 1 before seed 0.
    runs.swap(2, 6);
    runs.swap(3, 7);
    assert_eq!(drawn(runs), in_order);
}

#[test]
fn degenerate_curves_are_drawn_or_skipped() {
    let with_curve = |curve: Vec<CurvePoint>| {
        let mut run = run("trex", "static3dgs", 0, 30.0);
        run.set_curve(curve);
        figure(&report(vec![run]), &TableGenerationParams::default(), "curves.svg")
    };
    let at = |seconds, psnr_val| CurvePoint { seconds, iteration: 0, n_gaussians: 0, psnr_val };
    let cases = [
        (vec![], false),
        (vec![at(1.0, None)], false),
        (vec![at(f64::NAN, Some(20.0))], false),
        (vec![at(0.0, Some(20.0))], true),
        (vec![at(5.0, Some(20.0)), at(9.0, Some(20.0))], true),
        (vec![at(5.0, Some(20.0)), at(5.0, Some(21.0))], true),
    ];
    for (i, (curve, is_drawn)) in cases.into_iter().enumerate() {
        let figure = with_curve(curve);
        assert_eq!(figure.is_some(), is_drawn, "case {i}");
        let text = figure.map(|figure| svg_file::file(&figure)).unwrap_or_default();
        assert!(!text.contains("NaN") && !text.contains('–'), "case {i}: {text}");
    }
}
