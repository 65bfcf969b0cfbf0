use metric_evaluation::Score;
use table_generation::RunFailure;

use super::*;

fn run(row: &str, scene: &str, psnr: f64) -> Run {
    let protocol = scene::Protocol {
        dataset: "d".into(),
        split: "s".into(),
        width: 9,
        height: 9,
        resize: "none".into(),
        background: "white".into(),
        time: "t".into(),
    };
    let mut run = Run { row: row.into(), scene: scene.into(), seed: "0".into(), ..Run::default() };
    (run.protocol, run.judged_by) = (Some(protocol), Some("test images".into()));
    run.figures = [
        (Column::PSNR, Score::Value(psnr)),
        (Column::Metric(Metric::Ssim), Score::undefined("too small")),
        (Column::Gaussians, Score::Value(200.0)),
        (Column::TrainingSecs, Score::Value(7.0)),
    ]
    .into();
    set_loss(&mut run, "l1", 0.8);
    set_loss(&mut run, "flow", 0.2);
    set_loss(&mut run, "off", 0.0);
    run
}

fn set_loss(run: &mut Run, name: &str, value_share: f64) {
    run.costs.loss_shares.entry(name.into()).or_default().value_share = value_share;
}

fn failed(kind: FailureKind) -> Run {
    let failure = RunFailure { producer: "train".into(), kind, message: "no".into() };
    Run { row: "f".into(), scene: "a".into(), seed: "0".into(), failure: Some(failure), ..Run::default() }
}

fn runs() -> Vec<Run> {
    vec![run("m", "a", 20.123_456_7), run("m", "b", 25.0), failed(FailureKind::Diverged)]
}

fn deviations(found: &[Run]) -> Vec<String> {
    let text = CheckedTable::of("r", &runs(), None).to_text().unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    CheckedTable::read(file.path()).unwrap().check("r", found).deviations
}

#[test]
fn devices_and_folders_are_not_read_as_tables() {
    for path in ["/dev/null", env!("CARGO_MANIFEST_DIR")] {
        let error = CheckedTable::read(Path::new(path)).expect_err("no regular file").to_string();
        assert!(error.contains("not a regular file") && error.contains(path), "{error}");
    }
}

#[test]
fn a_missing_table_is_to_be_written() {
    let error = CheckedTable::read(Path::new("no-such-table.toml")).expect_err("no file").to_string();
    assert!(error.contains("no-such-table.toml") && error.contains("--write-check FILE"), "{error}");
}

#[test]
fn a_table_agrees_with_itself_and_stores_no_times() {
    assert_eq!(deviations(&runs()), Vec::<String>::new());
    let table = CheckedTable::of("r", &runs(), None);
    assert_eq!(table.check("r", &runs()).compared, 2 * 2 + 2 * 2);
    let text = table.to_text().unwrap();
    assert!(text.contains("psnr = 20.1235") && !text.contains("secs"), "{text}");
    assert!(table.check("other", &runs()).deviations[0].contains("other"));
}

#[test]
fn every_kind_of_deviation_is_named() {
    type Change = fn(&mut Vec<Run>);
    let changes: [(&str, Change); 15] = [
        ("psnr within tolerance", |runs| runs[1] = run("m", "b", 25.2)),
        ("psnr beyond tolerance", |runs| runs[1] = run("m", "b", 25.3)),
        ("psnr is NaN", |runs| runs[1] = run("m", "b", f64::NAN)),
        ("a run is removed", |runs| drop(runs.remove(0))),
        ("a run is added", |runs| runs.push(run("n", "a", 1.0))),
        ("another protocol", |runs| runs[0].protocol.iter_mut().for_each(|protocol| protocol.width = 8)),
        ("no protocol", |runs| runs[0].protocol = None),
        ("another failure", |runs| runs[2] = failed(FailureKind::Crashed)),
        ("no failure", |runs| runs[2] = run("f", "a", 20.0)),
        ("ssim becomes defined", |runs| {
            runs[0].figures.insert(Column::Metric(Metric::Ssim), Score::Value(0.5));
        }),
        ("gaussians become undefined", |runs| {
            runs[0].figures.insert(Column::Gaussians, Score::undefined("no model"));
        }),
        ("loss within tolerance", |runs| set_loss(&mut runs[0], "flow", 0.3)),
        ("loss beyond tolerance", |runs| set_loss(&mut runs[0], "flow", 0.04)),
        ("loss removed", |runs| set_loss(&mut runs[0], "flow", 0.0)),
        ("loss added", |runs| set_loss(&mut runs[0], "new", 0.1)),
    ];
    let mut found = String::new();
    for (name, change) in changes {
        let mut runs = runs();
        change(&mut runs);
        found += &format!("{name}:\n");
        deviations(&runs).iter().for_each(|line| found += &format!("  {line}\n"));
    }
    insta::assert_snapshot!(found);
}

#[test]
fn rewriting_a_file_keeps_its_tolerances() {
    let mut earlier = CheckedTable::of("r", &runs(), None);
    earlier.tolerances = [(Column::PSNR, Amount::Percent(50.0))].into();
    let again = CheckedTable::of("r", &runs(), Some(&earlier));
    assert_eq!(again.tolerances, earlier.tolerances);
    assert!(again.tables[0].runs[0].values.len() == 1);
    assert!(
        again
            .check("r", &[run("m", "a", 29.0), run("m", "b", 14.0), failed(FailureKind::Diverged)])
            .deviations
            .is_empty()
    );
}

#[test]
fn other_files_are_refused() {
    let file = tempfile::NamedTempFile::new().unwrap();
    for wrong in
        ["", "recipe = 3", "recipe = \"r\"\n[tolerances]\npsnr = -1.0", "recipe = \"r\"\n[tolerances]\npsnrr = 1"]
    {
        std::fs::write(file.path(), wrong).unwrap();
        let refused = CheckedTable::read(file.path()).unwrap_err();
        assert_eq!(refused.exit_code(), 3, "{wrong}");
    }
}

#[test]
fn errors_name_the_line_and_suggest_the_metric() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let text = CheckedTable::of("r", &runs(), None).to_text().unwrap();
    for (good, bad, expected) in [
        ("psnr = 0.25", "psnrr = 0.25", "(`psnrr = 0.25`): no column is called `psnrr`; did you mean `psnr`?"),
        (
            "psnr = 0.25",
            "psnr = \"abc\"",
            "(`psnr = \"abc\"`): expected a non-negative number (e.g. 0.1 or 2%), not abc",
        ),
        (
            "psnr = 0.25",
            "psnr = true",
            "(`psnr = true`): expected a non-negative number (e.g. 0.1) or text (e.g. \"2%\")",
        ),
        ("psnr = 25.0", "psnrr = 25.0", "(`[[table.run]]`): no column is called `psnrr`; did you mean `psnr`?"),
        ("psnr = 25.0", "psnr = true", "(`[[table.run]]`): expected a number, or text that says why there is none"),
    ] {
        assert!(text.contains(good), "{text}");
        std::fs::write(file.path(), text.replacen(good, bad, 1)).unwrap();
        let error = CheckedTable::read(file.path()).unwrap_err().to_string();
        assert!(error.contains("not a table to check against: line ") && error.contains(expected), "{error}");
    }
    std::fs::write(file.path(), "").unwrap();
    let error = CheckedTable::read(file.path()).unwrap_err().to_string();
    assert!(error.contains("not a table to check against: missing field `recipe`"), "{error}");
}

#[test]
fn damaged_files_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("table.toml");
    std::fs::write(&path, CheckedTable::of("r", &runs(), None).to_text().unwrap()).unwrap();
    let read = |path: &Path| CheckedTable::read(path).map(|table| drop(table.check("r", &runs())));
    let refused = support::mangle::refused(&path, 400, read);
    assert!(refused >= 100, "only {refused} of 400 damaged files were refused");
}
