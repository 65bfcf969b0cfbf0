//! Every format is well formed, complete and stable.

use engine::Artifact;

use super::*;
use crate::curves::svg_files;
use crate::{ReportFolder, csv_file, html, latex, typeset};

/// A report with every kind of content and awkward names.
fn awkward() -> Report {
    let mut runs = two_by_two();
    runs.push(run("a_b & <c>|d", "static3dgs", 0, 21.0));
    runs.push(failed("a_b & <c>|d", "deformable4dgs", 0, FailureKind::Diverged));
    runs.push(failed("lego", "static3dgs", 0, FailureKind::MissingData));
    report(runs)
}

#[test]
fn equal_reports_have_equal_bytes_and_read_back() {
    let (first, second) = (tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder"));
    let params = TableGenerationParams::default();
    let written = ReportFolder::write(awkward(), &params, first.path()).expect("written");
    ReportFolder::write(awkward(), &params, second.path()).expect("written");
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
    assert_eq!(n_files, 6 + 3, "five texts, all curves, and one SVG per scene");
    std::fs::remove_file(first.path().join("report.tex")).expect("removed");
    assert!(opened.check().is_err(), "a missing file was accepted");
}

#[test]
fn markdown_rows_have_as_many_cells_as_their_header() {
    let text = crate::markdown::markdown(&typeset::document(&awkward(), &TableGenerationParams::default()));
    let cells = |line: &str| line.replace("\\|", "").matches('|').count();
    let lines: Vec<&str> = text.lines().collect();
    let mut n_tables = 0;
    for (i, line) in lines.iter().enumerate().filter(|(_, line)| line.starts_with("| ---")) {
        n_tables += 1;
        let rows = lines[i - 1..].iter().take_while(|row| row.starts_with('|'));
        rows.for_each(|row| assert_eq!(cells(row), cells(line), "{row}"));
    }
    assert!(n_tables >= 7, "{text}");
    assert!(text.contains("a\\_b & \\<c>\\|d"), "{text}");
}

#[test]
fn latex_is_balanced_and_escaped() {
    let text = latex::latex(&typeset::document(&awkward(), &TableGenerationParams::default()));
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
    let text = csv_file::csv(&report(runs.clone())).expect("CSV");
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().expect("a header").clone();
    let column = |name: &str| header.iter().position(|heading| heading == name).expect("a column");
    let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().expect("parses");
    assert_eq!(rows.len(), runs.len());
    assert_eq!(rows[0][column("psnr")].parse::<f64>().expect("a number"), 1.0 / 3.0);
    assert_eq!(&rows[0][column("ms_ssim")], "");
    assert_eq!(&rows[0][column("model_key")], "0123456789ab");
    assert_eq!((&rows[8][column("scene")], &rows[8][column("failure")]), ("lego, \"test\"", "no data"));
}

#[test]
fn html_closes_every_element_and_needs_no_other_file() {
    let text = html::html(&typeset::document(&awkward(), &TableGenerationParams::default()));
    for element in ["html", "head", "body", "table", "thead", "tbody", "tr", "td", "th", "p", "svg", "g", "figure"] {
        let opened = text.matches(&format!("<{element}>")).count() + text.matches(&format!("<{element} ")).count();
        assert_eq!(opened, text.matches(&format!("</{element}>")).count(), "{element}");
    }
    assert!(!text.contains("src=") && !text.contains("href="), "refers to another file");
    assert!(text.contains("a_b &amp; &lt;c&gt;|d"));
}

#[test]
fn curves_have_a_line_a_label_and_a_band_per_method() {
    for log_time in [false, true] {
        let params = TableGenerationParams { log_time, ..Default::default() };
        let files = svg_files(&report(two_by_two()), &params);
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["curves.svg", "curves-bouncingballs.svg", "curves-trex.svg"]);
        let svg = &files[1].1;
        for part in [
            ">static3dgs ",
            ">deformable4dgs ",
            "stroke-dasharray=\"7 3\"",
            "training time (s)",
            "PSNR on validation views (dB)",
        ] {
            assert!(svg.contains(part), "{part} is missing: {svg}");
        }
        assert_eq!(svg.matches("opacity=\"0.15\"").count(), 2, "a band per method with two seeds");
        assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains('–'), "{svg}");
    }
}

#[test]
fn degenerate_curves_are_drawn_or_left_out() {
    let with_curve = |curve: Vec<CurvePoint>| {
        let mut run = run("trex", "static3dgs", 0, 30.0);
        run.set_curve(curve);
        svg_files(&report(vec![run]), &TableGenerationParams::default())
    };
    let at = |seconds, psnr_val| CurvePoint { seconds, iteration: 0, n_gaussians: 0, psnr_val };
    let cases = [
        (vec![], 1),
        (vec![at(1.0, None)], 1),
        (vec![at(f64::NAN, Some(20.0))], 1),
        (vec![at(0.0, Some(20.0))], 2),
        (vec![at(5.0, Some(20.0)), at(9.0, Some(20.0))], 2),
        (vec![at(5.0, Some(20.0)), at(5.0, Some(21.0))], 2),
    ];
    for (i, (curve, n_files)) in cases.into_iter().enumerate() {
        let files = with_curve(curve);
        assert_eq!(files.len(), n_files, "case {i}");
        assert!(files.iter().all(|(_, svg)| !svg.contains("NaN") && !svg.contains('–')), "case {i}: {files:?}");
    }
}
