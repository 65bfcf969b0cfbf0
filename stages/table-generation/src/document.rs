//! A document as sections of blocks: the common source of Markdown, LaTeX and HTML.

use crate::pictures::Sheet;
use crate::svg::Panel;

/// A document.
pub(crate) struct Document {
    /// The title.
    pub title: String,
    /// The sections, from top to bottom.
    pub sections: Vec<Section>,
}

/// A part of a document with a heading.
pub(crate) struct Section {
    /// Id for links.
    pub id: &'static str,
    /// The heading.
    pub heading: &'static str,
    /// Whether only the HTML page contains the section, because it is too long for a terminal or a paper.
    pub page_only: bool,
    /// The blocks, from top to bottom.
    pub blocks: Vec<Block>,
}

/// A part of a section.
pub(crate) enum Block {
    /// A heading below the section's.
    Heading(String),
    /// Running text.
    Paragraph(String),
    /// A table.
    Table(Table),
    /// A figure.
    Figure(Figure),
    /// Renders next to the ground truth; HTML only.
    Pictures(Vec<Sheet>),
}

/// Panels with a common legend: a separate SVG file, and inline in the HTML page.
pub(crate) struct Figure {
    /// Name of the SVG file.
    pub file: String,
    /// The caption.
    pub caption: String,
    /// The legend of lines, markers and areas.
    pub legend: Vec<Key>,
    /// The panels.
    pub panels: Vec<Panel>,
}

/// An entry of a legend.
pub(crate) struct Key {
    /// A sample of the style, drawn in a box of [`crate::svg::SAMPLE`] pixels.
    pub sample: maud::Markup,
    /// The number that identifies the entry inside panels.
    pub number: Option<usize>,
    /// The label.
    pub label: String,
}

/// A table. The first `n_text` columns are left-aligned text, and the first of them names the row. All other columns
/// are right-aligned numbers, except for a last column of sentences.
pub(crate) struct Table {
    /// The caption.
    pub caption: String,
    /// Headings over several columns: text and number of columns; empty without such headings.
    pub groups: Vec<(String, usize)>,
    /// Column headings.
    pub header: Vec<String>,
    /// Number of text columns.
    pub n_text: usize,
    /// Whether the last column has sentences, which are left-aligned and wrap.
    pub ends_in_sentences: bool,
    /// The rows: as many cells as the header has, or a single cell: a heading over the rows below it, or code that belongs to
    /// the row above it.
    pub rows: Vec<Vec<Text>>,
    /// Footnotes that cells refer to.
    pub notes: Vec<String>,
    /// Remarks about the whole table.
    pub remarks: Vec<String>,
}

/// The text of a cell.
#[derive(Clone, Debug, Default)]
pub(crate) struct Text {
    /// The text without markup.
    pub text: String,
    /// Rank in the column, 1 for the best; ranks 1 to 3 are emphasised, 0 means no rank.
    pub rank: usize,
    /// Link to the source of the value on the page.
    pub link: Option<Link>,
    /// Id of the cell, a target of links.
    pub id: Option<String>,
    /// Whether the text is code, e.g. a command.
    pub is_code: bool,
}

/// A link to a place on the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Link {
    /// Id of the place.
    pub to: String,
    /// Tooltip of the link.
    pub hint: String,
}

impl Text {
    /// Text without emphasis.
    pub(crate) fn plain(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// Code, e.g. a command or a key.
    pub(crate) fn code(text: impl Into<String>) -> Self {
        Self { is_code: true, ..Self::plain(text) }
    }

    /// Adds a link to the text.
    pub(crate) fn linked(self, link: Option<Link>) -> Self {
        Self { link, ..self }
    }
}

impl Key {
    /// Number and label of the entry.
    pub(crate) fn text(&self) -> String {
        self.number.map(|number| format!("{number} ")).unwrap_or_default() + &self.label
    }
}

impl Table {
    /// A table without rows and notes.
    pub(crate) fn new(caption: impl Into<String>, header: Vec<String>) -> Self {
        let (groups, rows, notes, remarks) = Default::default();
        Self { caption: caption.into(), groups, header, n_text: 1, ends_in_sentences: false, rows, notes, remarks }
    }

    /// Makes the first `count` columns text columns.
    pub(crate) fn with_text_columns(self, count: usize) -> Self {
        Self { n_text: count, ..self }
    }

    /// Makes the last column one of sentences.
    pub(crate) fn ending_in_sentences(self) -> Self {
        Self { ends_in_sentences: true, ..self }
    }

    /// Whether the column is left-aligned.
    pub(crate) fn is_text(&self, column: usize) -> bool {
        column < self.n_text || self.has_sentences(column)
    }

    /// Whether the column is the last one and has sentences.
    pub(crate) fn has_sentences(&self, column: usize) -> bool {
        self.ends_in_sentences && column + 1 == self.header.len()
    }

    /// The lines below the table: footnotes with their marks, then the remarks.
    pub(crate) fn lines_below(&self) -> impl Iterator<Item = String> {
        let marked = |(index, note): (usize, &String)| match note.starts_with('[') {
            // Footnotes about sources already contain their mark, e.g. `[1]`.
            true => note.clone(),
            false => format!("({}) {note}", note_mark(index)),
        };
        self.notes.iter().enumerate().map(marked).chain(self.remarks.iter().cloned())
    }

    /// Adds a footnote and returns its mark, e.g. `a`; equal footnotes share a mark.
    pub(crate) fn note(&mut self, note: String) -> String {
        let index = self.notes.iter().position(|other| *other == note).unwrap_or_else(|| {
            self.notes.push(note);
            self.notes.len() - 1
        });
        note_mark(index)
    }

    /// The column headings with the headings above them, for formats without headings over several columns.
    pub(crate) fn flat_header(&self) -> Vec<String> {
        let above = self.groups.iter().flat_map(|(text, columns)| std::iter::repeat_n(text.as_str(), *columns));
        let both = |(above, own): (&str, &String)| match (above, own.as_str()) {
            ("", own) => own.to_owned(),
            (above, "") => above.to_owned(),
            (above, own) => format!("{above}: {own}"),
        };
        self.header.iter().enumerate().map(|(at, own)| both((above.clone().nth(at).unwrap_or(""), own))).collect()
    }
}

/// The parts of a text, and whether each is code, i.e. stands between a pair of backticks. Without pairs nothing is code.
pub(crate) fn code_spans(text: &str) -> impl Iterator<Item = (bool, &str)> {
    let has_pairs = text.matches('`').count().is_multiple_of(2);
    let parts: Vec<&str> = if has_pairs { text.split('`').collect() } else { vec![text] };
    parts.into_iter().enumerate().map(|(at, part)| (at % 2 == 1, part))
}

/// The mark of the footnote with this index: `a` to `z`, then `a1`, `b1`, …
pub(crate) fn note_mark(index: usize) -> String {
    let letter = char::from(b'a' + (index % 26) as u8);
    if index < 26 { letter.into() } else { format!("{letter}{}", index / 26) }
}
