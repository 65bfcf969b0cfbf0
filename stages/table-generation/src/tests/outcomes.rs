//! The table of outcomes.

use engine::FailureKind;
use insta::assert_snapshot;
use training::LargestGradient;

use super::*;
use crate::collect::TensorGradient;
use crate::markdown::markdown;
use crate::sections;

/// A run with a gradient and a guard.
fn trained(method: &str, psnr: f64) -> Run {
    let largest = LargestGradient { magnitude: 1234.5, phase: "fine".into(), iteration: 7 };
    let largest = TensorGradient { tensor: "positions".into(), largest };
    let guards = [("colours below zero".to_owned(), 12)].into();
    Run { largest_gradient: Some(largest), guards, ..run("trex", method, 0, psnr) }
}

/// The section with the table of outcomes as Markdown, if there is one.
fn outcomes(runs: Vec<Run>, hard_cases: bool) -> Option<String> {
    let params = TableGenerationParams { hard_cases, ..TableGenerationParams::default() };
    let report = Report::new(runs, &[], &params);
    let mut document = sections::document(&report, Vec::new(), &params).expect("a document");
    document.sections.retain(|section| section.id == "outcomes");
    (!document.sections.is_empty()).then(|| markdown(&document))
}

#[test]
fn outcomes_list_gain_gradient_and_guards() {
    let crashed = failed("trex", "scgs", 0, FailureKind::Crashed);
    let runs = vec![trained("static3dgs", 25.0), trained("mcgs", 26.5), crashed];
    assert_snapshot!(outcomes(runs.clone(), true).expect("a table"));
    assert_eq!(outcomes(runs, false), None, "not requested, and no run diverged");
}

#[test]
fn gains_are_over_the_baseline_with_the_same_axis_values() {
    let scaled = |method: &str, scale: &str, psnr: f64| Run {
        axes: [("scale".to_owned(), scale.to_owned())].into(),
        row: format!("{method} scale={scale}"),
        ..trained(method, psnr)
    };
    let runs = vec![scaled("static3dgs", "1", 25.0), scaled("static3dgs", "2", 26.0), scaled("mcgs", "2", 26.5)];
    let text = outcomes(runs, true).expect("a table");
    let line = text.lines().find(|line| line.contains("mcgs scale=2")).expect("a line");
    assert!(line.contains("| +0.50 |"), "{line}");
}

#[test]
fn divergence_shows_the_table_of_outcomes() {
    let mut diverged = failed("trex", "mcgs", 0, FailureKind::Diverged);
    diverged.failure.as_mut().expect("a failure").message = "gradient of scales is not finite at iteration 3".into();
    let text = outcomes(vec![trained("static3dgs", 25.0), diverged], false).expect("a table");
    let line = "| mcgs | diverged | gradient of scales is not finite at iteration 3 | – | – | – |";
    assert!(text.contains(line), "{text}");
}

#[test]
fn gains_are_over_the_whole_baseline_of_an_axis_of_parts() {
    let whole = |method: &str, psnr: f64| Run {
        variant: Some("whole".into()),
        row: format!("{method} without=nothing"),
        ..trained(method, psnr)
    };
    let part = Run {
        variant: Some("without motion".into()),
        row: "static3dgs without=motion".into(),
        ..trained("static3dgs", 20.0)
    };
    let text = outcomes(vec![part, whole("static3dgs", 25.0), whole("mcgs", 26.5)], true).expect("a table");
    let line = text.lines().find(|line| line.contains("mcgs without=nothing")).expect("a line");
    assert!(line.contains("| +1.50 |"), "{line}");
}
