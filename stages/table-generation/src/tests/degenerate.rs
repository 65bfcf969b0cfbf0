//! Degenerate runs: a separate outcome in every format, and in no mean, rank, gain, verdict or comparison.

use insta::assert_snapshot;
use metric_evaluation::Degenerate;

use super::content::{document, section, text};
use super::formats::figure;
use super::*;
use crate::claims::Verdict;
use crate::collect::{DEGENERATE, DegenerateRun};
use crate::{csv_file, html, latex, svg_file};

/// A run whose renders are not better than a constant image.
fn degenerate(scene: &str, method: &str, seed: u32) -> Run {
    let degenerate = DegenerateRun {
        kind: Degenerate::NotAboveConstant,
        message: "the renders are not better than a constant image: 14.50 dB; best constant image: 15.00 dB".into(),
        advice: vec!["93 % of the pixels have the background's colour".into(), "a longer schedule".into()],
    };
    Run { degenerate: Some(degenerate), ..run(scene, method, seed, 14.5) }
}

/// Two methods on two scenes, of which one run is degenerate.
fn one_of_four() -> Vec<Run> {
    let mut runs: Vec<Run> = two_by_two().into_iter().filter(|run| run.seed == "0").collect();
    runs[3] = degenerate("trex", "deformable4dgs", 0);
    runs
}

#[test]
fn degenerate_runs_belong_to_no_mean_rank_gain_or_verdict() {
    let report = report(one_of_four());
    let [baseline, row] = report.groups[0].rows.as_slice() else { panic!("two rows") };
    for column in [Column::PSNR, Column::TrainingSecs, Column::Gaussians, Column::PsnrAtEnd, Column::AboveConstant] {
        let cell = &row.by_scene["trex"][&column];
        assert_eq!((cell.mean, cell.rank, cell.reason.as_deref()), (None, None, Some(DEGENERATE)), "{column:?}");
        assert_eq!(row.headline[&column].mean, None, "{column:?} has a mean over a hole");
        assert_eq!(baseline.by_scene["trex"][&column].rank, None, "{column:?} is ranked against a degenerate run");
    }
    assert_eq!(row.by_scene["bouncingballs"][&Column::PSNR].mean, Some(40.5));
    assert!((row.phases["blend"] - 30.0).abs() <= 1e-9 && report.failures.is_empty());
    let claims = report.groups[0].claims.iter().filter(|table| table.row == "deformable4dgs");
    let trex = claims.flat_map(|table| &table.columns).filter_map(|column| column.entries[1].as_ref());
    let verdicts: Vec<&Verdict> = trex.map(|(_, verdict)| verdict).collect();
    assert!(!verdicts.is_empty() && verdicts.iter().all(|verdict| is_without_judgement(verdict)), "{verdicts:?}");
    assert_snapshot!("degenerate_results", section(&report, "results"));
    assert_snapshot!("degenerate_failures", section(&report, "failures"));
}

fn is_without_judgement(verdict: &Verdict) -> bool {
    matches!(verdict, Verdict::NotMeasured | Verdict::NotComparable)
}

#[test]
fn every_format_names_degenerate_runs() {
    let report = report(one_of_four());
    let text = text(&report);
    assert!(text.contains("4 runs: 3 finished, 1 × degenerate."), "{text}");
    assert!(text.contains("no better than an image that needs no model: deformable4dgs on trex;"), "{text}");
    assert!(text.contains("| static3dgs | 2 | 2 | 0 |") && text.contains("| deformable4dgs | 2 | 1 | 1 |"), "{text}");
    let csv = csv_file::runs(&report).expect("a file");
    let line = csv.lines().find(|line| line.contains("deformable4dgs,trex")).expect("a line");
    assert!(line.contains(",degenerate,") && line.contains(",14.5,"), "{line}");
    let json = serde_json::to_string(&report).expect("a text");
    assert!(json.contains(r#""kind":"not-above-constant""#), "{json}");
    for page in [html::html(&document(&report)), latex::latex(&document(&report))] {
        assert!(page.contains("degenerate") && page.contains("a longer schedule"), "{page}");
    }
}

#[test]
fn pictures_over_frames_and_time_leave_out_degenerate_runs() {
    let mut runs = two_by_two();
    let pictures = |runs: Vec<Run>| {
        let params = TableGenerationParams::default();
        ["frames.svg", "curves.svg"]
            .map(|file| svg_file::file(&figure(&report(runs.clone()), &params, file).expect(file)))
    };
    runs[3] = degenerate("trex", "deformable4dgs", 0);
    let with = pictures(runs.clone());
    runs[3].frames.iter_mut().for_each(|frame| frame.psnr -= 9.0);
    runs[3].curve.iter_mut().for_each(|point| point.psnr_val = point.psnr_val.map(|psnr| psnr - 9.0));
    assert_eq!(pictures(runs), with);
}

#[test]
fn degenerate_seeds_are_counted_as_missing() {
    let mut runs = two_by_two();
    runs[3] = degenerate("trex", "deformable4dgs", 0);
    let report = report(runs);
    let cell = &report.groups[0].rows[1].headline[&Column::PSNR];
    assert_eq!((cell.n(), cell.n_expected, cell.reason.as_deref()), (1, 2, Some("trex: degenerate")));
}
