//! Typesets documents as Markdown with pipe tables.

use crate::document::{Block, Document, Figure, Table, Text};

/// The document as Markdown, without the sections that only the page contains.
pub(crate) fn markdown(document: &Document) -> String {
    let mut text = format!("# {}\n", escape(&document.title));
    for section in document.sections.iter().filter(|section| !section.page_only) {
        text += &format!("\n## {}\n", escape(section.heading));
        for block in &section.blocks {
            match block {
                Block::Heading(heading) => text += &format!("\n### {}\n", escape(heading)),
                Block::Paragraph(paragraph) => text += &format!("\n{}\n", escape(paragraph)),
                Block::Table(table) => text += &format!("\n{}", table_text(table)),
                Block::Figure(Figure { file, caption, .. }) => text += &format!("\n![{}]({file})\n", escape(caption)),
                Block::Pictures(_) => {}
            }
        }
    }
    text
}

fn table_text(table: &Table) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let rule = (0..table.header.len()).map(|column| if column < table.n_text { "---" } else { "---:" }.to_owned());
    let mut text = format!("**{}**\n\n", escape(&table.caption));
    text += &line(table.flat_header().iter().map(|heading| escape(heading)).collect());
    text += &line(rule.collect());
    for row in &table.rows {
        let blank = (row.len()..table.header.len()).map(|_| String::new());
        text += &line(row.iter().map(cell).chain(blank).collect());
    }
    for (index, line) in table.lines_below().enumerate() {
        text += &format!("{}{}  \n", if index == 0 { "\n" } else { "" }, escape(&line));
    }
    text
}

fn cell(cell: &Text) -> String {
    let text = escape(&cell.text);
    if cell.rank == 1 { format!("**{text}**") } else { text }
}

/// Escapes characters that would end a cell or start markup.
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
