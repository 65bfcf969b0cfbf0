//! `inspect`, `eval`, `completions`: without a recipe.

use std::path::Path;

use clap::CommandFactory;
use engine::{Failure, FailureKind, exit};
use metric_evaluation::{MetricEvaluationParams, evaluate_folders_with};

use crate::args::{Cli, EvalArgs};
use crate::error::CliError;
use crate::output::{print, print_json, print_line};

/// An error if the user named a folder that is none.
fn require_folder(path: &Path) -> Result<(), CliError> {
    let no_folder = || Failure::new(FailureKind::BadInput, "no such folder").at(path);
    if path.is_dir() { Ok(()) } else { Err(anyhow::Error::from(no_folder()).into()) }
}

/// Describes a capture, or prints a recipe for it alone; an exit code other than 0 if it cannot be imported.
pub fn inspect(dir: &Path, recipe_alone: bool) -> Result<u8, CliError> {
    if dir.is_file() {
        let failure = Failure::new(FailureKind::BadInput, "a capture is a folder, this is a file");
        return Err(anyhow::Error::from(failure.hint("name the folder that the file lies in").at(dir)).into());
    }
    require_folder(dir)?;
    let found = sfm_import::inspect::inspect(dir).map_err(CliError::of_input)?;
    match found.recipe() {
        Some(recipe) if recipe_alone => print_line(recipe.trim_end())?,
        None if recipe_alone => {
            let failure = Failure::new(FailureKind::BadInput, "nothing here can be imported");
            return Err(anyhow::Error::from(failure.hint("without --recipe, inspect says why").at(dir)).into());
        }
        _ => print_line(found.text().trim_end())?,
    }
    if found.captures.iter().all(|capture| capture.problems.is_empty()) {
        return Ok(exit::OK);
    }
    Err(CliError::of_input(anyhow::anyhow!("not everything can be imported; see the problems: {}", dir.display())))
}

pub fn eval(args: &EvalArgs) -> Result<u8, CliError> {
    require_folder(&args.renders)?;
    require_folder(&args.truth)?;
    let weights = args.lpips_weights.as_deref();
    weights.map_or(Ok(()), require_folder)?;
    let params = MetricEvaluationParams::default();
    let metrics = evaluate_folders_with(&args.renders, &args.truth, &params, weights, None);
    let metrics = metrics.map_err(CliError::of_input)?;
    if args.json {
        print_json(&metrics)?;
    } else {
        print_line(metrics.summary().trim_end())?;
    }
    Ok(exit::OK)
}

pub fn completions(shell: clap_complete::Shell) -> Result<u8, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "pipeline", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(exit::OK)
}
