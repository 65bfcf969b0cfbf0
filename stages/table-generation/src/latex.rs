//! Typesets documents as LaTeX, to be included with `\input` in a document that loads `booktabs`.

use crate::document::{Block, Document, Figure, Table, Text, code_spans};

/// The document as LaTeX, without the sections that only the page contains; figures are comments that name their files.
pub(crate) fn latex(document: &Document) -> String {
    let mut text = String::from(
        "% Requires \\usepackage{booktabs}. Redefine these commands to change the emphasis of ranks.\n\
         \\providecommand{\\best}[1]{\\textbf{#1}}\n\
         \\providecommand{\\second}[1]{\\underline{#1}}\n\
         \\providecommand{\\third}[1]{\\textit{#1}}\n",
    );
    text += &format!("\\section*{{{}}}\n", escape(&document.title));
    for section in document.sections.iter().filter(|section| !section.page_only) {
        text += &format!("\n\\subsection*{{{}}}\n", escape(section.heading));
        for block in &section.blocks {
            text += "\n";
            match block {
                Block::Heading(heading) => text += &format!("\\subsubsection*{{{}}}\n", escape(heading)),
                Block::Paragraph(paragraph) => text += &format!("{}\n", escape(paragraph)),
                Block::Table(table) => text += &table_text(table),
                Block::Figure(Figure { file, caption, .. }) => {
                    text += &format!("% figure {file}: {}\n", escape(caption));
                }
                Block::Pictures(_) => {}
            }
        }
    }
    text
}

fn table_text(table: &Table) -> String {
    let alignment: String = (0..table.header.len()).map(|at| if table.is_text(at) { 'l' } else { 'r' }).collect();
    let line = |cells: Vec<String>| format!("{} \\\\\n", cells.join(" & "));
    let mut text = format!("\\begin{{table}}\n\\centering\n\\caption{{{}}}\n", escape(&table.caption));
    text += &format!("\\begin{{tabular}}{{{alignment}}}\n\\toprule\n");
    text += &line(table.flat_header().iter().map(|heading| escape(heading)).collect());
    text += "\\midrule\n";
    for row in &table.rows {
        let blank = (row.len()..table.header.len()).map(|_| String::new());
        text += &line(row.iter().map(cell).chain(blank).collect());
    }
    text += "\\bottomrule\n\\end{tabular}\n";
    for line in table.lines_below() {
        text += &format!("\\par\\footnotesize {}\n", escape(&line));
    }
    text + "\\end{table}\n"
}

fn cell(cell: &Text) -> String {
    let text = escape(&cell.text);
    match cell.rank {
        1 => format!("\\best{{{text}}}"),
        2 => format!("\\second{{{text}}}"),
        3 => format!("\\third{{{text}}}"),
        _ => text,
    }
}

/// Escapes a text, and sets its parts between backticks as code.
fn escape(text: &str) -> String {
    let part = |(is_code, part)| match escape_characters(part) {
        text if is_code => format!("\\texttt{{{text}}}"),
        text => text,
    };
    code_spans(text).map(part).collect()
}

/// Escapes characters that LaTeX interprets, and replaces symbols by commands.
fn escape_characters(text: &str) -> String {
    let escaped = |c: char| match c {
        '&' | '%' | '$' | '#' | '_' | '{' | '}' => format!("\\{c}"),
        '\\' => "\\textbackslash{}".into(),
        '~' => "\\textasciitilde{}".into(),
        '^' => "\\textasciicircum{}".into(),
        // LaTeX would read a bracket after `\\\\` as the optional argument of the line break.
        '[' | ']' => format!("{{{c}}}"),
        '±' => "$\\pm$".into(),
        '×' => "$\\times$".into(),
        '·' => "$\\cdot$".into(),
        '−' => "$-$".into(),
        '–' => "--".into(),
        '≈' => "$\\approx$".into(),
        '≥' => "$\\ge$".into(),
        '✓' => "$\\surd$".into(),
        'Δ' => "$\\Delta$".into(),
        '\n' => " ".into(),
        _ => c.into(),
    };
    let mut before = None;
    let in_text = |c: char| match before.replace(c) {
        // LaTeX would print two hyphens, e.g. of an option, as one dash.
        Some('-') if c == '-' => "{}-".into(),
        _ => escaped(c),
    };
    text.chars().map(in_text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_between_backticks_is_code() {
        assert_eq!(escape("see `show a_b`, 5 %"), "see \\texttt{show a\\_b}, 5 \\%");
        assert_eq!(escape("a single ` mark"), "a single ` mark");
    }

    #[test]
    fn options_keep_both_hyphens() {
        assert_eq!(escape("set --lpips-weights – or not"), "set -{}-lpips-weights -- or not");
    }
}
