//! The errors of a recipe: all of them at once, each with its place.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::places::{Place, Texts, line_at};

/// One error of a recipe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecipeError {
    /// The file, or the option (e.g. `-s`) for an override.
    pub file: PathBuf,
    /// The line number, from 1; 0 if the error concerns the whole file.
    pub line: usize,
    /// The column in characters, from 1; 0 if the error concerns the whole file.
    pub column: usize,
    /// The dotted key, e.g. `nodes.train.params.iterations`; empty if the error concerns no key.
    pub key: String,
    /// The problem, in lower case, without a full stop.
    pub message: String,
    /// Advice, e.g. the nearest valid name and all allowed names.
    pub hint: Option<String>,
    /// The text of the line.
    pub source_line: String,
    /// Number of characters to mark, starting at `column`.
    pub width: usize,
}

/// All errors of a recipe, in the order of the files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct RecipeErrors(pub Vec<RecipeError>);

impl RecipeError {
    /// An error about the bytes `span` of the text of a file.
    pub fn in_text(
        file: &Path,
        text: &str,
        span: Range<usize>,
        key: impl Into<String>,
        message: impl Into<String>,
        hint: Option<String>,
    ) -> Self {
        let (line, column, source_line) = line_at(text, span.start);
        let left = source_line.chars().count().saturating_sub(column - 1);
        let marked = text.get(span).map_or(0, |text| text.chars().count());
        Self {
            file: file.to_owned(),
            line,
            column,
            key: key.into(),
            message: message.into(),
            hint,
            source_line: source_line.into(),
            width: marked.min(left).max(1),
        }
    }
}

impl std::error::Error for RecipeErrors {}

impl fmt::Display for RecipeErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [error] = &self.0[..] {
            return f.write_str(error.to_string().trim_end());
        }
        for error in &self.0 {
            writeln!(f, "{error}")?;
        }
        write!(f, "{} errors in the recipe", self.0.len())
    }
}

impl fmt::Display for RecipeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "error: {}", self.message)?;
        if self.line > 0 {
            write!(f, "  at {}:{}:{}", self.file.display(), self.line, self.column)?;
            writeln!(f, "{}", if self.key.is_empty() { String::new() } else { format!(", key {}", self.key) })?;
        }
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
    pub(super) texts: Texts,
    errors: Vec<(Place, RecipeError)>,
}

impl Report {
    /// Adds an error. Errors with the same place and message count once, even if several jobs or nodes have them.
    pub(super) fn add(
        &mut self,
        place: &Place,
        key: impl Into<String>,
        message: impl Into<String>,
        hint: Option<String>,
    ) {
        let text = self.texts.get(place.text);
        let error = RecipeError::in_text(&text.path, &text.text, place.start..place.end, key, message, hint);
        let is_same = |(at, known): &(Place, RecipeError)| at == place && known.message == error.message;
        if !self.errors.iter().any(is_same) {
            self.errors.push((*place, error));
        }
    }

    /// Adds an error about a whole file, e.g. one that cannot be read. Its message names the file.
    pub(super) fn add_for_file(&mut self, text: usize, message: impl Into<String>, hint: Option<String>) {
        let error = RecipeError {
            file: self.texts.get(text).path.clone(),
            line: 0,
            column: 0,
            key: String::new(),
            message: message.into(),
            hint,
            source_line: String::new(),
            width: 0,
        };
        self.errors.push((Place::new(text, 0..0), error));
    }

    /// Whether an error about `key` at `place` is already in the report.
    pub(super) fn has(&self, place: &Place, key: &str) -> bool {
        self.errors.iter().any(|(known, error)| known == place && error.key == key)
    }

    /// Whether any error about `key` is already in the report.
    pub(super) fn concerns(&self, key: &str) -> bool {
        self.errors.iter().any(|(_, error)| error.key == key)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.errors.is_empty()
    }

    /// The value, or the errors if there are any.
    pub(super) fn finish<T>(mut self, value: Option<T>) -> Result<T, RecipeErrors> {
        self.errors.sort_by_key(|(place, _)| *place);
        let errors: Vec<RecipeError> = self.errors.into_iter().map(|(_, error)| error).collect();
        match value {
            Some(value) if errors.is_empty() => Ok(value),
            _ => Err(RecipeErrors(errors)),
        }
    }
}

/// "a → b → a".
pub(super) fn join_arrows(names: impl Iterator<Item = String>) -> String {
    names.collect::<Vec<_>>().join(" → ")
}
