//! Places of keys and values in the texts of a recipe.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::plan::Origin;

/// The texts of a recipe (files and overrides), in the order in which they were opened.
#[derive(Default)]
pub(super) struct Texts(Vec<Text>);

/// One file or override.
pub(super) struct Text {
    pub(super) path: PathBuf,
    pub(super) text: String,
    pub(super) is_override: bool,
}

/// A range of bytes in one text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Place {
    /// Index of the text.
    pub(super) text: usize,
    pub(super) start: usize,
    pub(super) end: usize,
    /// The number of the enclosing `[[set]]`, from 1.
    pub(super) rule: Option<usize>,
}

impl Place {
    pub(super) fn new(text: usize, span: Range<usize>) -> Self {
        Self { text, start: span.start, end: span.end, rule: None }
    }

    /// Whether both places are the same range of the same text.
    pub(super) fn is_same_text(&self, other: &Self) -> bool {
        (self.text, self.start, self.end) == (other.text, other.start, other.end)
    }
}

impl Texts {
    /// Adds a text and returns its index.
    pub(super) fn add(&mut self, path: &Path, text: String, is_override: bool) -> usize {
        self.0.push(Text { path: path.to_owned(), text, is_override });
        self.0.len() - 1
    }

    pub(super) fn get(&self, index: usize) -> &Text {
        &self.0[index]
    }

    /// Whether `place` lies in a recipe that the resolved one extends. The resolved one is the first text.
    pub(super) fn is_in_base(&self, place: &Place) -> bool {
        place.text > 0 && !self.get(place.text).is_override
    }

    /// The line number of `place`, from 1.
    fn line(&self, place: &Place) -> usize {
        line_at(&self.get(place.text).text, place.start).0
    }

    /// The line of `place`, for a message about the place `from`: `line 3`, or `base.toml:3` if the texts differ.
    pub(super) fn line_name(&self, place: &Place, from: &Place) -> String {
        let line = self.line(place);
        if place.text == from.text {
            format!("line {line}")
        } else {
            format!("{}:{line}", self.get(place.text).path.display())
        }
    }

    /// The origin of a value at `place`.
    pub(super) fn origin(&self, place: &Place) -> Origin {
        let (text, line) = (self.get(place.text), self.line(place));
        match place.rule {
            _ if text.is_override => Origin::CommandLine,
            Some(number) => Origin::Set { number, file: text.path.clone(), line },
            None => Origin::File { file: text.path.clone(), line },
        }
    }
}

/// The line number from 1, the column in characters from 1, and the whole line around byte `start` of a text.
pub(super) fn line_at(text: &str, start: usize) -> (usize, usize, &str) {
    let start = (0..=start.min(text.len())).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
    let line_start = text[..start].rfind('\n').map_or(0, |at| at + 1);
    let line = text[line_start..].lines().next().unwrap_or("");
    (text[..line_start].matches('\n').count() + 1, text[line_start..start].chars().count() + 1, line)
}
