//! Documents as one HTML page that needs no other file.

use crate::document::{Block, Document, Table, Text};
use crate::markdown::note_line;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;\
color:#1a1a1a;background:#fff}table{border-collapse:collapse;margin:.5rem 0}caption{text-align:left;font-weight:600;\
padding:.3rem 0}th,td{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #ddd}th:first-child,\
td:first-child{text-align:left}thead th{border-bottom:2px solid #333}.best{font-weight:700}\
.second{text-decoration:underline}.third{font-style:italic}.note{font-size:.85em;color:#444;margin:.1rem 0}\
figure{margin:1rem 0}.wide{overflow-x:auto}";

/// The document as a self-contained page.
pub fn html(document: &Document) -> String {
    let title = escape(&document.title);
    let mut text = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"><title>{title}</title>\n\
         <style>{STYLE}</style></head>\n<body>\n<h1>{title}</h1>\n"
    );
    for block in &document.blocks {
        match block {
            Block::Heading(heading) => text += &format!("<h2>{}</h2>\n", escape(heading)),
            Block::Paragraph(paragraph) => text += &format!("<p>{}</p>\n", escape(paragraph)),
            Block::Table(table) => text += &table_text(table),
            Block::Figure { svg, caption, .. } => {
                text += &format!("<figure>\n{svg}<figcaption>{}</figcaption></figure>\n", escape(caption));
            }
        }
    }
    text + "</body>\n</html>\n"
}

fn table_text(table: &Table) -> String {
    let mut text = format!("<div class=\"wide\"><table><caption>{}</caption>\n<thead><tr>", escape(&table.caption));
    text.extend(table.header.iter().map(|heading| format!("<th>{}</th>", escape(heading))));
    text += "</tr></thead>\n<tbody>\n";
    for row in &table.rows {
        let cells: String = row.iter().map(cell).collect();
        text += &format!("<tr>{cells}</tr>\n");
    }
    text += "</tbody></table></div>\n";
    let notes = table.notes.iter().enumerate();
    text.extend(notes.map(|(i, note)| format!("<p class=\"note\">{}</p>\n", escape(&note_line(i, note)))));
    text
}

fn cell(cell: &Text) -> String {
    let class = match cell.rank {
        1 => " class=\"best\"",
        2 => " class=\"second\"",
        3 => " class=\"third\"",
        _ => "",
    };
    format!("<td{class}>{}</td>", escape(&cell.text))
}

/// Characters with a meaning in HTML and SVG.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
