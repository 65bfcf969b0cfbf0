//! Measured runs, from the report of a recipe or from a report's file.

use std::path::Path;

use anyhow::Context;
use engine::status::State;
use engine::{Failure, FailureKind};
use metric_evaluation::Score;
use serde::Deserialize;
use table_generation::{Column, Run};

use crate::args::{Conditions, RecipeArgs};
use crate::error::CliError;
use crate::session::Session;
use crate::verbs::results::tables;

/// The file of a report that holds everything unrounded.
const REPORT: &str = "report.json";

/// The part of a report's file that is compared.
#[derive(Deserialize)]
struct Runs {
    runs: Vec<Run>,
}

/// The runs that `named` holds: of a recipe (`.toml`) what it last came to under the conditions, or of a report's folder or file.
pub fn open(store: &Path, named: &Path, with: &Conditions) -> Result<Vec<Run>, CliError> {
    if named.extension().is_some_and(|extension| extension == "toml") {
        let recipe = RecipeArgs { recipe: named.to_owned(), with: with.clone() };
        return of_recipe(&Session::look(store, &recipe)?);
    }
    read(&if named.is_dir() { named.join(REPORT) } else { named.to_owned() })
}

/// The runs of all tables that a recipe last came to; a warning tells if they are not of its present state.
pub fn of_recipe(session: &Session) -> Result<Vec<Run>, CliError> {
    collect(session, |index| Ok(session.record(index)?.content))
}

/// The runs of all tables of a recipe, which must be of its present state.
pub fn current(session: &Session) -> Result<Vec<Run>, CliError> {
    let predictions = session.predict()?;
    collect(session, |index| match predictions.get(&index).map(|prediction| &prediction.state) {
        Some(State::Cached { record }) => Ok(record.content),
        _ => {
            let name = &session.plan.nodes[index].name;
            Err(CliError::nothing(format!("{name} is not up to date"), "run the recipe first"))
        }
    })
}

fn collect(
    session: &Session,
    content: impl Fn(usize) -> Result<engine::Digest, CliError>,
) -> Result<Vec<Run>, CliError> {
    let mut runs = Vec::new();
    for index in tables(session)? {
        runs.extend(read(&session.store.view(&content(index)?)?.join(REPORT))?);
    }
    Ok(runs)
}

fn read(path: &Path) -> Result<Vec<Run>, CliError> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()));
    let bytes = bytes.map_err(CliError::of_input)?;
    let no_report = |error: serde_json::Error| {
        let message = format!("not the file of a report ({error})");
        let hint = format!("name a recipe, the folder of a report, or its {REPORT}");
        CliError::of_input(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into())
    };
    Ok(serde_json::from_slice::<Runs>(&bytes).map_err(no_report)?.runs)
}

/// A run's figure, or why it has none.
pub fn figure(run: &Run, column: Column) -> Result<f64, String> {
    match run.figures.get(&column) {
        Some(Score::Value(value)) if value.is_finite() => Ok(*value),
        Some(Score::Value(_)) => Err("not finite".into()),
        Some(Score::Undefined { undefined }) => Err(undefined.clone()),
        None => Err(run.failure.as_ref().map_or("not measured".into(), |failure| failure.message.clone())),
    }
}

/// What a run is called: row, scene and seed.
pub fn name(run: &Run) -> String {
    format!("{} on {}, seed {}", run.row, run.scene, run.seed)
}
