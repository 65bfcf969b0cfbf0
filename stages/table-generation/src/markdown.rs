//! Documents as Markdown with pipe tables.

use crate::document::{Block, Document, Table, Text, note_mark};

/// The document as Markdown.
pub fn markdown(document: &Document) -> String {
    let mut text = format!("# {}\n", escape(&document.title));
    for block in &document.blocks {
        text += "\n";
        match block {
            Block::Heading(heading) => text += &format!("## {}\n", escape(heading)),
            Block::Paragraph(paragraph) => text += &format!("{}\n", escape(paragraph)),
            Block::Table(table) => text += &table_text(table),
            Block::Figure { file, caption, .. } => text += &format!("![{}]({file})\n", escape(caption)),
        }
    }
    text
}

fn table_text(table: &Table) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let rule = (0..table.header.len()).map(|column| if column == 0 { "---" } else { "---:" }.to_owned());
    let mut text = format!("**{}**\n\n", escape(&table.caption));
    text += &line(table.header.iter().map(|heading| escape(heading)).collect());
    text += &line(rule.collect());
    for row in &table.rows {
        text += &line(row.iter().map(cell).collect());
    }
    for (index, note) in table.notes.iter().enumerate() {
        text += &format!("{}{}  \n", if index == 0 { "\n" } else { "" }, escape(&note_line(index, note)));
    }
    text
}

/// A footnote with its mark; sources bring their own.
pub fn note_line(index: usize, note: &str) -> String {
    if note.starts_with(['[', '±']) { note.into() } else { format!("({}) {note}", note_mark(index)) }
}

fn cell(cell: &Text) -> String {
    let text = escape(&cell.text);
    if cell.rank == 1 { format!("**{text}**") } else { text }
}

/// Characters that would end a cell or start markup.
fn escape(text: &str) -> String {
    let special = |c: char| matches!(c, '|' | '*' | '_' | '`' | '<' | '\\');
    text.chars().fold(String::new(), |mut escaped, c| {
        if special(c) {
            escaped.push('\\');
        }
        escaped.push(if c == '\n' { ' ' } else { c });
        escaped
    })
}
