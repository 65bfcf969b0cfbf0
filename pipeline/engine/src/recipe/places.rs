//! Where in which text a key or a value stands.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::plan::Origin;

/// The texts that a recipe is read from, in the order in which they were opened.
#[derive(Default)]
pub(crate) struct Texts(Vec<Text>);

pub(crate) struct Text {
    pub path: PathBuf,
    pub text: String,
    pub is_override: bool,
}

/// A stretch of one text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub text: usize,
    pub start: usize,
    pub end: usize,
    /// The number of the `[[set]]` that it lies in, from 1.
    pub rule: Option<usize>,
}

impl Place {
    pub fn new(text: usize, span: Range<usize>) -> Self {
        Self { text, start: span.start, end: span.end, rule: None }
    }
}

impl Texts {
    pub fn add(&mut self, path: &Path, text: String, is_override: bool) -> usize {
        self.0.push(Text { path: path.to_owned(), text, is_override });
        self.0.len() - 1
    }

    pub fn get(&self, index: usize) -> &Text {
        &self.0[index]
    }

    /// The line number from 1, the column in characters from 1, and the whole line around the start of `place`.
    pub fn line(&self, place: &Place) -> (usize, usize, &str) {
        let text = &self.get(place.text).text;
        let start = (0..=place.start.min(text.len())).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
        let line_start = text[..start].rfind('\n').map_or(0, |at| at + 1);
        let line = text[line_start..].lines().next().unwrap_or("");
        (text[..line_start].matches('\n').count() + 1, text[line_start..start].chars().count() + 1, line)
    }

    /// How a value at `place` came into the plan.
    pub fn origin(&self, place: &Place) -> Origin {
        let (text, line) = (self.get(place.text), self.line(place).0);
        match place.rule {
            _ if text.is_override => Origin::CommandLine,
            Some(number) => Origin::Set { number, file: text.path.clone(), line },
            None => Origin::File { file: text.path.clone(), line },
        }
    }
}
