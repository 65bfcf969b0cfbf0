//! The search that a recipe or the command line defines.

use std::path::Path;

use engine::{Failure, FailureKind, builtin_name};

use crate::args::{RunArgs, SweepArgs, SweepSettings};
use crate::error::CliError;
use crate::output::note;
use crate::stages::stages;

/// The search that a recipe or the command line defines, if any.
pub(crate) fn settings(args: &RunArgs) -> Result<Option<SweepSettings>, CliError> {
    if let Some(key) = args.sweep.repeated() {
        return Err(CliError::Usage(format!("--sweep {key} occurs twice: list all of its values in one --sweep")));
    }
    let settings = args.sweep.settings(&args.recipe.recipe, &recipe_text(&args.recipe.recipe))?;
    if let (None, Some(option)) = (&settings, args.sweep.named()) {
        return Err(CliError::Usage(format!("{option} belongs to a search: add --sweep KEY=VALUES")));
    }
    match args.named_for_single_runs().filter(|_| settings.is_some()) {
        Some(option) => {
            let message = format!("the recipe has [sweep], and a search does not have {option}");
            let failure = Failure::new(FailureKind::BadInput, message);
            let hint = "omit the option, or run a recipe without [sweep], which may extend the same files";
            Err(CliError::Input(failure.hint(hint).at(&args.recipe.recipe).into()))
        }
        None => Ok(settings),
    }
}

/// Notes that `run` searches over a recipe, which a plan shows with its own values only. Returns the errors of `[sweep]`.
pub(crate) fn note_search(recipe: &Path) -> Result<(), CliError> {
    if let Some(settings) = SweepArgs::default().settings(recipe, &recipe_text(recipe))? {
        let keys: Vec<&str> = settings.space.0.iter().map(|parameter| parameter.key.as_str()).collect();
        let keys = keys.join(", ");
        note(&format!("the recipe has [sweep]: `run` searches over {keys}; this shows the recipe with its own values"));
    }
    Ok(())
}

/// The text of a recipe; empty if it cannot be read, because resolving the recipe reports the error.
fn recipe_text(path: &Path) -> String {
    match builtin_name(path) {
        Some(name) => {
            stages().recipes().iter().find(|(known, _)| *known == name).map_or("", |(_, text)| *text).to_owned()
        }
        None => std::fs::read_to_string(path).unwrap_or_default(),
    }
}
