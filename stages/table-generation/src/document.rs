//! A document as blocks, so that Markdown, LaTeX and HTML say the same.

/// A document.
pub struct Document {
    /// The title.
    pub title: String,
    /// The content, top to bottom.
    pub blocks: Vec<Block>,
}

/// A part of a document.
pub enum Block {
    /// A section's heading.
    Heading(String),
    /// Running text.
    Paragraph(String),
    /// A table.
    Table(Table),
    /// A figure in a file beside the document.
    Figure {
        /// The SVG file's name.
        file: String,
        /// The SVG text.
        svg: String,
        /// What it shows.
        caption: String,
    },
}

/// A table: the first column is left-aligned, the others right-aligned.
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// One per column.
    pub header: Vec<String>,
    /// As many cells per row as the header has.
    pub rows: Vec<Vec<Text>>,
    /// Footnotes.
    pub notes: Vec<String>,
}

/// The text of a cell.
#[derive(Clone, Debug, Default)]
pub struct Text {
    /// Plain text.
    pub text: String,
    /// 1 for the best value of the column, then 2 and 3; 0 for no emphasis.
    pub rank: usize,
}

impl Text {
    /// Text without emphasis.
    pub fn plain(text: impl Into<String>) -> Self {
        Self { text: text.into(), rank: 0 }
    }
}

impl Table {
    /// A table without rows or notes.
    pub fn new(caption: impl Into<String>, header: Vec<String>) -> Self {
        Self { caption: caption.into(), header, rows: Vec::new(), notes: Vec::new() }
    }

    /// The mark of a footnote, as `a`; equal notes share a mark.
    pub fn note(&mut self, note: String) -> String {
        let index = self.notes.iter().position(|other| *other == note).unwrap_or_else(|| {
            self.notes.push(note);
            self.notes.len() - 1
        });
        note_mark(index)
    }
}

/// `a` to `z`, then `a1`, `b1`, …
pub fn note_mark(index: usize) -> String {
    let letter = char::from(b'a' + (index % 26) as u8);
    if index < 26 { letter.into() } else { format!("{letter}{}", index / 26) }
}
