//! The subset of YAML that OpenCV's `FileStorage` writes: keys at the start of a line, matrices, numbers, lists of names.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::error::{Result, bad};
use crate::files::read_text;

/// More numbers than any calibration matrix has.
const MAX_NUMBERS: usize = 64;

/// A file: its entries by key.
pub(super) struct FileStorage {
    path: PathBuf,
    entries: BTreeMap<String, Entry>,
}

/// A value with the number of the line that it starts on.
struct Entry {
    line: usize,
    lines: Vec<String>,
}

/// A matrix in row-major order.
pub(super) struct Matrix {
    pub(super) shape: [usize; 2],
    pub(super) values: Vec<f64>,
}

impl FileStorage {
    /// Splits a file into entries; values are parsed on first use.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let mut entries: BTreeMap<String, Entry> = BTreeMap::new();
        let mut key = None;
        for (line, text) in (1..).zip(text.lines()) {
            let is_comment = text.starts_with(['%', '#']) || text.starts_with("---") || text.trim().is_empty();
            let is_continued = text.starts_with([' ', '\t', '-']);
            match text.split_once(':').filter(|_| !is_continued) {
                _ if is_comment => (),
                Some((name, value)) => {
                    let entry = Entry { line, lines: vec![value.trim().to_owned()] };
                    if entries.insert(name.trim().to_owned(), entry).is_some() {
                        return Err(bad(format!("line {line}: {} is stated twice", name.trim())).at(path));
                    }
                    key = Some(name.trim().to_owned());
                }
                None => {
                    let entry = key.as_ref().filter(|_| is_continued).and_then(|key| entries.get_mut(key));
                    let entry = entry.ok_or_else(|| bad(format!("line {line}: not a key with a value")).at(path))?;
                    entry.lines.push(text.trim().to_owned());
                }
            }
        }
        Ok(Self { path: path.into(), entries })
    }

    /// The keys, sorted.
    pub(super) fn keys(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The matrix of a key, if the file has it.
    pub(super) fn matrix(&self, key: &str) -> Result<Option<Matrix>> {
        let Some(entry) = self.entries.get(key) else { return Ok(None) };
        let text = entry.lines.join(" ");
        let matrix = parse_matrix(&text).ok_or_else(|| self.damaged(entry, key, "not a matrix of OpenCV"))?;
        if let Some(value) = matrix.values.iter().find(|value| !value.is_finite()) {
            return Err(self.damaged(entry, key, &format!("contains {value}")));
        }
        Ok(Some(matrix))
    }

    /// The number of a key, if the file has it.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(entry) = self.entries.get(key) else { return Ok(None) };
        let number = entry.lines.concat().parse().ok().filter(|number: &f64| number.is_finite());
        number.map(Some).ok_or_else(|| self.damaged(entry, key, "not a number"))
    }

    /// The list of names of a key: one per line after a dash, or in brackets.
    pub(super) fn names(&self, key: &str) -> Option<Vec<String>> {
        let lines = &self.entries.get(key)?.lines;
        let bare = |item: &str| item.trim().trim_matches(['"', '\'']).to_owned();
        let listed = lines.concat();
        let names: Vec<String> = match listed.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            Some(items) => items.split(',').map(bare).collect(),
            None => lines.iter().filter_map(|line| line.strip_prefix('-')).map(bare).collect(),
        };
        Some(names.into_iter().filter(|name| !name.is_empty()).collect())
    }

    fn damaged(&self, entry: &Entry, key: &str, what: &str) -> engine::Failure {
        bad(format!("line {}: {key} is {what}", entry.line)).at(&self.path)
    }
}

/// A matrix of the form `!!opencv-matrix rows: 3 cols: 1 dt: d data: [ 1., 2., 3. ]`.
fn parse_matrix(text: &str) -> Option<Matrix> {
    let after = |label: &str| text.split_once(label).map(|(_, rest)| rest.trim_start());
    let side = |label: &str| after(label)?.split_whitespace().next()?.parse::<usize>().ok();
    let shape = [side("rows:")?, side("cols:")?];
    let data = after("data:")?.strip_prefix('[')?.split_once(']')?.0;
    let number = |item: &str| item.trim().parse::<f64>().ok();
    let values: Vec<f64> = data.split(',').take(MAX_NUMBERS + 1).map(number).collect::<Option<_>>()?;
    (shape[0].checked_mul(shape[1])? == values.len() && values.len() <= MAX_NUMBERS).then_some(Matrix { shape, values })
}
