//! A document as sections of blocks, so that Markdown, LaTeX and HTML say the same.

use crate::pictures::Sheet;
use crate::svg::Panel;

/// A document.
pub struct Document {
    /// The title.
    pub title: String,
    /// The content, top to bottom.
    pub sections: Vec<Section>,
}

/// A part of a document with a heading.
pub struct Section {
    /// What links lead to it by.
    pub id: &'static str,
    /// The heading.
    pub heading: &'static str,
    /// Whether it is details that the page alone has: what is too long for a terminal or a paper.
    pub page_only: bool,
    /// The content.
    pub blocks: Vec<Block>,
}

/// A part of a section.
pub enum Block {
    /// A heading below the section's.
    Heading(String),
    /// Running text.
    Paragraph(String),
    /// A table.
    Table(Table),
    /// A figure.
    Figure(Figure),
    /// Renders beside true images; on the page alone.
    Pictures(Vec<Sheet>),
}

/// Panels with a common legend, in a file of their own and on the page.
pub struct Figure {
    /// The SVG file's name.
    pub file: String,
    /// What it shows.
    pub caption: String,
    /// What lines, points and areas stand for.
    pub legend: Vec<Key>,
    /// The panels.
    pub panels: Vec<Panel>,
}

/// An entry of a legend.
pub struct Key {
    /// A sample, drawn in a box of [`crate::svg::SAMPLE`] pixels.
    pub sample: maud::Markup,
    /// The number that stands for it where there is no room for the sample.
    pub number: Option<usize>,
    /// What it stands for.
    pub label: String,
}

/// A table: its first columns are text and left-aligned, the first of them names the row; the others are right-aligned.
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// Headings over several columns, as text and number of columns; empty where there are none.
    pub groups: Vec<(String, usize)>,
    /// One per column.
    pub header: Vec<String>,
    /// How many columns are text.
    pub n_text: usize,
    /// As many cells per row as the header has; a single cell is a heading over the rows below it.
    pub rows: Vec<Vec<Text>>,
    /// Footnotes, which cells refer to.
    pub notes: Vec<String>,
    /// What is to be said about the table as a whole.
    pub remarks: Vec<String>,
}

/// The text of a cell.
#[derive(Clone, Debug, Default)]
pub struct Text {
    /// Plain text.
    pub text: String,
    /// 1 for the best value of the column, then 2 and 3; 0 for no emphasis.
    pub rank: usize,
    /// The place on the page that shows where the text comes from.
    pub link: Option<Link>,
    /// The place on the page that this cell is.
    pub id: Option<String>,
    /// Whether it is something to type.
    pub is_code: bool,
}

/// A place on the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    /// Its id.
    pub to: String,
    /// What a pointer resting on the link is told.
    pub hint: String,
}

impl Text {
    /// Text without emphasis.
    pub fn plain(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// Something to type.
    pub fn code(text: impl Into<String>) -> Self {
        Self { is_code: true, ..Self::plain(text) }
    }

    /// The same text, leading to a place.
    pub fn linked(self, link: Option<Link>) -> Self {
        Self { link, ..self }
    }
}

impl Key {
    /// The legend as text.
    pub fn text(&self) -> String {
        self.number.map(|number| format!("{number} ")).unwrap_or_default() + &self.label
    }
}

impl Table {
    /// A table without rows and notes.
    pub fn new(caption: impl Into<String>, header: Vec<String>) -> Self {
        let (groups, rows, notes, remarks) = Default::default();
        Self { caption: caption.into(), groups, header, n_text: 1, rows, notes, remarks }
    }

    /// The same table, whose first `count` columns are text.
    pub fn with_text_columns(self, count: usize) -> Self {
        Self { n_text: count, ..self }
    }

    /// Footnotes with their marks, and then the remarks.
    pub fn lines_below(&self) -> impl Iterator<Item = String> {
        let marked = |(index, note): (usize, &String)| match note.starts_with('[') {
            // Sources bring their own marks.
            true => note.clone(),
            false => format!("({}) {note}", note_mark(index)),
        };
        self.notes.iter().enumerate().map(marked).chain(self.remarks.iter().cloned())
    }

    /// The mark of a footnote, as `a`; equal notes share a mark.
    pub fn note(&mut self, note: String) -> String {
        let index = self.notes.iter().position(|other| *other == note).unwrap_or_else(|| {
            self.notes.push(note);
            self.notes.len() - 1
        });
        note_mark(index)
    }

    /// The headings with those above them, for formats without headings over several columns.
    pub fn flat_header(&self) -> Vec<String> {
        let above = self.groups.iter().flat_map(|(text, columns)| std::iter::repeat_n(text.as_str(), *columns));
        let both = |(above, own): (&str, &String)| match (above, own.as_str()) {
            ("", own) => own.to_owned(),
            (above, "") => above.to_owned(),
            (above, own) => format!("{above}: {own}"),
        };
        self.header.iter().enumerate().map(|(at, own)| both((above.clone().nth(at).unwrap_or(""), own))).collect()
    }
}

/// `a` to `z`, then `a1`, `b1`, …
pub fn note_mark(index: usize) -> String {
    let letter = char::from(b'a' + (index % 26) as u8);
    if index < 26 { letter.into() } else { format!("{letter}{}", index / 26) }
}
