//! The table of what became of every run.

use engine::FailureKind;
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

fn text(runs: Vec<Run>, hard_cases: bool) -> String {
    let params = TableGenerationParams { hard_cases, ..TableGenerationParams::default() };
    let report = Report::new(runs, &[], &params);
    markdown(&sections::document(&report, Vec::new(), &params).expect("a document"))
}

#[test]
fn every_run_has_its_outcome_gain_gradient_and_guards() {
    let crashed = failed("trex", "scgs", 0, FailureKind::Crashed);
    let runs = vec![trained("static3dgs", 25.0), trained("mcgs", 26.5), crashed];
    let text = text(runs.clone(), true);
    let place = "positions, iteration 7 of fine | colours below zero ×12";
    for line in [
        format!("| static3dgs | finished | {place} | – | 1.2e3 |"),
        format!("| mcgs | finished | {place} | +1.50 | 1.2e3 |"),
        "| scgs | failed: crash | trex went wrong | – | – | – |".into(),
    ] {
        assert!(text.contains(&line), "no {line} in {text}");
    }
    assert!(!self::text(runs, false).contains("What became of every run"), "nobody asked, and nothing diverged");
}

#[test]
fn a_training_that_diverged_shows_the_table_with_what_was_not_finite() {
    let mut diverged = failed("trex", "mcgs", 0, FailureKind::Diverged);
    diverged.failure.as_mut().expect("a failure").message = "gradient of scales is not finite at iteration 3".into();
    let text = text(vec![trained("static3dgs", 25.0), diverged], false);
    assert!(
        text.contains("| mcgs | diverged | gradient of scales is not finite at iteration 3 | – | – | – |"),
        "{text}"
    );
}
