//! Everything that is wrong with a recipe, at once, each with its place.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use super::places::{Place, Texts};

/// One thing that is wrong with a recipe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecipeError {
    /// The file, or `-s` for an override.
    pub file: PathBuf,
    /// From 1.
    pub line: usize,
    /// In characters, from 1.
    pub column: usize,
    /// The dotted key concerned, as `nodes.train.params.iterations`; empty if none is.
    pub key: String,
    /// What is wrong, lower case, without a full stop.
    pub message: String,
    /// What to do about it: the nearest valid name, the names allowed.
    pub hint: Option<String>,
    /// The line concerned.
    pub source_line: String,
    /// Characters to mark, from `column` on.
    pub width: usize,
}

/// All errors of a recipe, in the order of the files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct RecipeErrors(pub Vec<RecipeError>);

impl std::error::Error for RecipeErrors {}

impl fmt::Display for RecipeErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for error in &self.0 {
            writeln!(f, "{error}")?;
        }
        let plural = if self.0.len() == 1 { "" } else { "s" };
        write!(f, "{} error{plural} in the recipe", self.0.len())
    }
}

impl fmt::Display for RecipeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "error: {}", self.message)?;
        write!(f, "  at {}:{}:{}", self.file.display(), self.line, self.column)?;
        writeln!(f, "{}", if self.key.is_empty() { String::new() } else { format!(", key {}", self.key) })?;
        if !self.source_line.trim().is_empty() {
            writeln!(f, "  | {}", self.source_line.replace('\t', " "))?;
            writeln!(f, "  | {}{}", " ".repeat(self.column - 1), "^".repeat(self.width))?;
        }
        if let Some(hint) = &self.hint {
            writeln!(f, "  hint: {hint}")?;
        }
        Ok(())
    }
}

/// Collects errors while a recipe is read and resolved.
#[derive(Default)]
pub(crate) struct Report {
    pub texts: Texts,
    errors: Vec<(Place, RecipeError)>,
}

impl Report {
    /// Adds an error; the same one counts once, whatever jobs and nodes it concerns.
    pub fn add(&mut self, place: &Place, key: impl Into<String>, message: impl Into<String>, hint: Option<String>) {
        let (line, column, source_line) = self.texts.line(place);
        let left = source_line.chars().count().saturating_sub(column - 1);
        let text = self.texts.get(place.text);
        let marked = text.text.get(place.start..place.end).map_or(0, |text| text.chars().count());
        let error = RecipeError {
            file: text.path.clone(),
            line,
            column,
            key: key.into(),
            message: message.into(),
            hint,
            source_line: source_line.into(),
            width: marked.min(left).max(1),
        };
        let is_same = |(at, known): &(Place, RecipeError)| at == place && known.message == error.message;
        if !self.errors.iter().any(is_same) {
            self.errors.push((*place, error));
        }
    }

    /// Whether there is an error about `key` at `place` already.
    pub fn has(&self, place: &Place, key: &str) -> bool {
        self.errors.iter().any(|(known, error)| known == place && error.key == key)
    }

    /// Whether there is an error about `key` anywhere already.
    pub fn concerns(&self, key: &str) -> bool {
        self.errors.iter().any(|(_, error)| error.key == key)
    }

    pub fn is_empty(&self) -> bool {
        self.errors.is_empty()
    }

    /// The errors so far, or the value.
    pub fn finish<T>(mut self, value: Option<T>) -> Result<T, RecipeErrors> {
        self.errors.sort_by_key(|(place, _)| *place);
        let errors: Vec<RecipeError> = self.errors.into_iter().map(|(_, error)| error).collect();
        match value {
            Some(value) if errors.is_empty() => Ok(value),
            _ => Err(RecipeErrors(errors)),
        }
    }
}

/// "did you mean `x`? allowed: x, y", from what the user wrote and what would have been right.
pub(crate) fn names_hint<'a>(wrong: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let allowed: Vec<&str> = allowed.into_iter().collect();
    let list = match allowed.is_empty() {
        true => "none is allowed here".into(),
        false => format!("allowed: {}", allowed.join(", ")),
    };
    match super::nearest(wrong, allowed.iter().copied()) {
        Some(name) => Some(format!("did you mean `{name}`? {list}")),
        None => Some(list),
    }
}
