//! `recipes`: the recipes that are built into the program.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use engine::{Builtins, Failure, FailureKind, exit};

use crate::args::RecipesVerb;
use crate::error::CliError;
use crate::output::{note, print};
use crate::stages::stages;

pub(crate) fn recipes(verb: &RecipesVerb) -> Result<u8, CliError> {
    let all = stages().recipes();
    match verb {
        RecipesVerb::List => print(&list(all))?,
        RecipesVerb::Show { name } => print(text(all, name, "recipe")?)?,
        RecipesVerb::Copy { name, file } => {
            let file = file.clone().unwrap_or_else(|| PathBuf::from(format!("{name}.toml")));
            let own = file.display().to_string();
            write_new(&file, &text(all, name, "recipe")?.replace(&format!("recipes/{name}.toml"), &own))?;
            note(&format!("wrote {own}; run it with: pipeline run {own}"));
        }
    }
    Ok(exit::OK)
}

/// The recipes that can be run, each with the first sentence of its comment, and then the parts of recipes.
fn list(all: Builtins) -> String {
    let is_part = |text: &str| !text.lines().any(|line| line.starts_with("name = "));
    let width = all.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let line = |(name, text): &(&str, &str)| format!("{name:<width$}  {}\n", about(text));
    let runnable: String = all.iter().filter(|(_, text)| !is_part(text)).map(line).collect();
    let parts: Vec<&str> = all.iter().filter(|(_, text)| is_part(text)).map(|(name, _)| *name).collect();
    format!("{runnable}\nparts to extend: {}\n", parts.join(", "))
}

/// The first sentence of the comment that a recipe begins with.
fn about(text: &str) -> String {
    let comment = text.lines().map_while(|line| line.strip_prefix('#'));
    let comment = comment.map(str::trim).collect::<Vec<_>>().join(" ");
    // "et al. 2021" is not the end of a sentence.
    let ends = comment.match_indices(". ").map(|(end, _)| end).find(|&end| !comment[..end].ends_with(" al"));
    comment[..ends.unwrap_or(comment.len())].trim_end_matches('.').to_owned()
}

/// The text called `name`.
pub(super) fn text(all: Builtins, name: &str, what: &str) -> Result<&'static str, CliError> {
    let name = name.strip_prefix("builtin:").unwrap_or(name);
    all.iter().find(|(known, _)| *known == name).map(|(_, text)| *text).ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
        CliError::nothing(format!("no built-in {what} is called `{name}`"), format!("choose one: {}", names.join(", ")))
    })
}

/// Writes a file that must not exist yet.
fn write_new(file: &Path, text: &str) -> Result<(), CliError> {
    let written = std::fs::File::create_new(file).and_then(|mut open| open.write_all(text.as_bytes()));
    written.map_err(|error| {
        let kind = match error.kind() {
            std::io::ErrorKind::AlreadyExists | std::io::ErrorKind::NotFound => FailureKind::BadInput,
            _ => FailureKind::World,
        };
        anyhow::Error::from(Failure::new(kind, format!("cannot write the recipe ({error})")).at(file)).into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_are_listed_with_their_first_sentence() {
        assert_eq!(about("# Two scenes,\n# small. Needs no data.\n\nname = \"x\"\n# Other.\n"), "Two scenes, small");
        assert_eq!(
            about("# D-NeRF (Pumarola et al. 2021) on white. Days.\n"),
            "D-NeRF (Pumarola et al. 2021) on white"
        );
        assert_eq!(about("name = \"x\"\n"), "");
    }
}
