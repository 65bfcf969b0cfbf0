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
    let rule = (0..table.header.len()).map(|column| if table.is_text(column) { "---" } else { "---:" }.to_owned());
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

/// Escapes characters that would end a cell or start markup. Pairs of backticks stay code spans; underscores within words
/// start no markup.
fn escape(text: &str) -> String {
    let has_code = text.matches('`').count().is_multiple_of(2);
    let (mut escaped, mut in_code, mut before) = (String::new(), false, None);
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        let in_word =
            before.is_some_and(char::is_alphanumeric) && rest.peek().is_some_and(|next| next.is_alphanumeric());
        let is_markup = match c {
            '|' => true,
            '`' => !has_code,
            '_' => !in_code && !in_word,
            '*' | '<' | '\\' => !in_code,
            _ => false,
        };
        in_code ^= c == '`' && has_code;
        escaped.extend(is_markup.then_some('\\'));
        escaped.push(if c == '\n' { ' ' } else { c });
        before = Some(c);
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_characters_that_are_markup_are_escaped() {
        let cases = [
            ("lpips_weights", "lpips_weights"),
            ("_start and end_", "\\_start and end\\_"),
            ("set `a_*` to 1 | 2", "set `a_*` to 1 \\| 2"),
            ("a single ` and *", "a single \\` and \\*"),
            ("two\nlines", "two lines"),
        ];
        cases.into_iter().for_each(|(text, escaped)| assert_eq!(escape(text), escaped));
    }
}
