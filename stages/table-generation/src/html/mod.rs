//! Typesets documents as one HTML page without scripts and external files.

mod pictures;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::document::{Block, Document, Figure, Section, Table, Text, code_spans};
use crate::svg::{Panel, SAMPLE};

/// Style sheet for light and dark mode, narrow and wide screens, and print.
const STYLE: &str = include_str!("style.css");

/// Number of characters from which a cell holds a sentence rather than a value.
const LONG_TEXT: usize = 40;

/// The document as a self-contained HTML page.
pub(crate) fn html(document: &Document) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (document.title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (document.title) }
                    nav aria-label="sections" {
                        ul { @for Section { id, heading, .. } in &document.sections { li { a href={ "#" (id) } { (heading) } } } }
                    }
                }
                main { @for part in &document.sections { (section(part)) } }
            }
        }
    };
    page.into_string() + "\n"
}

fn section(part: &Section) -> Markup {
    html! {
        section id=(part.id) {
            h2 { (part.heading) }
            @for block in &part.blocks {
                @match block {
                    Block::Heading(heading) => h3 { (heading) },
                    Block::Paragraph(paragraph) => p { (text(paragraph)) },
                    Block::Table(content) => (table(content)),
                    Block::Figure(content) => (figure(content)),
                    Block::Pictures(sheets) => (pictures::sheets(sheets, part.id)),
                }
            }
        }
    }
}

fn table(table: &Table) -> Markup {
    html! {
        @let noted = table.lines_below().next().is_some();
        @let labels = table.flat_header();
        div class=(if noted { "wide noted" } else { "wide" }) tabindex="0" role="region" aria-label=(table.caption) {
            table class=[is_wordy(table).then_some("wordy")] {
                caption { span { (table.caption) } }
                thead {
                    @if !table.groups.is_empty() {
                        tr { @for (text, columns) in &table.groups { th colspan=(columns) scope="colgroup" { (text) } } }
                    }
                    tr {
                        @for (at, heading) in table.header.iter().enumerate() {
                            th scope="col" class=[table.is_text(at).then_some("text")] { (heading) }
                        }
                    }
                }
                tbody { @for cells in &table.rows { (row(cells, table, &labels)) } }
            }
        }
        @for line in table.lines_below() { p class="note" { (text(&line)) } }
    }
}

/// Whether the table has so much text that a narrow screen shows each row as a block of labelled lines. Other tables
/// scroll.
fn is_wordy(table: &Table) -> bool {
    table.n_text > 2 || table.rows.iter().flatten().any(|cell| cell.text.chars().count() > LONG_TEXT)
}

/// A row that its first cell names, a heading over the rows below, or code that belongs to the row above. `labels` are the
/// headings of its cells.
fn row(cells: &[Text], table: &Table, labels: &[String]) -> Markup {
    html! {
        tr class=[matches!(cells, [only] if only.is_code).then_some("below")] {
            @match cells {
                [only] if only.is_code => td class="text" colspan=(table.header.len()) { (cell(only)) },
                [only] if table.header.len() > 1 => {
                    th class="over" colspan=(table.header.len()) scope="colgroup" { (cell(only)) }
                },
                [first, others @ ..] => {
                    th scope="row" id=[&first.id] { (cell(first)) }
                    @for (at, other) in others.iter().enumerate() {
                        td id=[&other.id] class=[class(other, at + 1, table)] data-label=[labels.get(at + 1)] { (cell(other)) }
                    }
                },
                [] => {},
            }
        }
    }
}

fn class(text: &Text, column: usize, table: &Table) -> Option<&'static str> {
    match text.rank {
        1 => Some("best"),
        2 => Some("second"),
        3 => Some("third"),
        _ if table.has_sentences(column) => Some("text sentence"),
        _ => (table.is_text(column) || text.is_code).then_some("text"),
    }
}

fn cell(content: &Text) -> Markup {
    html! {
        @if let Some(link) = &content.link {
            a href={ "#" (link.to) } title=(link.hint) { (text(&content.text)) }
        } @else if content.is_code {
            code { (words(&content.text)) }
        } @else {
            (text(&content.text))
        }
    }
}

/// A text in which parts between backticks are code.
fn text(content: &str) -> Markup {
    html! {
        @for (is_code, part) in code_spans(content) {
            @if is_code { code { (part) } } @else { (part) }
        }
    }
}

/// Words that no line break divides: browsers break lines after hyphens, e.g. between `-` and `s`.
fn words(content: &str) -> Markup {
    html! {
        @for (at, word) in content.split(' ').enumerate() {
            @if at > 0 { " " }
            span { (word) }
        }
    }
}

fn figure(figure: &Figure) -> Markup {
    html! {
        figure {
            ul class="legend" {
                @for key in &figure.legend {
                    li {
                        svg width=(SAMPLE[0]) height=(SAMPLE[1]) aria-hidden="true" { (key.sample) }
                        " " (key.text())
                    }
                }
            }
            div class="panels" { @for content in &figure.panels { (panel(content)) } }
            figcaption { (figure.caption) }
        }
    }
}

fn panel(panel: &Panel) -> Markup {
    let Panel { title, width, height, drawing } = panel;
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) role="img" aria-label=(title) {
            (drawing)
        }
    }
}
