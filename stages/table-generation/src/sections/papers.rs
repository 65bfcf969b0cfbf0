//! The papers' tables in their printed shape, with measured and third-party values next to each cell.

use super::cells::traced;
use super::content::Content;
use crate::claims::{Claim, Verdict};
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::library;
use crate::papers::{ComparedCell, Heading, Measured, Paper, PaperTable};

/// Tables with more columns than this show the values next to printed cells in lines instead of columns.
const MAX_COLUMNS: usize = 16;

/// Reasons for missing values that are longer than this go to a footnote, bytes.
const MAX_REASON: usize = 24;

/// The columns (or lines) of a printed cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Beside {
    Published,
    Measured,
    Verdict,
    Others,
}

/// All tables of the papers that the parameters name.
pub(crate) fn blocks(content: &Content<'_>) -> anyhow::Result<Vec<Block>> {
    let mut blocks = Vec::new();
    let claims = library::claims()?;
    for name in &content.params.papers {
        let paper = library::paper(name)?;
        blocks.push(Block::Heading(paper.reference()));
        let own = format!(" of {}", paper.name);
        let others: Vec<&Claim> = claims.iter().filter(|claim| !claim.source.ends_with(&own)).collect();
        for table in &paper.tables {
            blocks.push(Block::Table(Compared::new(&paper, table, content, &others).table(content)));
        }
    }
    Ok(blocks)
}

/// A table of a paper with the values next to its cells.
struct Compared<'a> {
    source: &'a PaperTable,
    caption: String,
    cells: Vec<Vec<ComparedCell>>,
}

impl<'a> Compared<'a> {
    fn new(paper: &Paper, source: &'a PaperTable, content: &Content<'_>, others: &[&Claim]) -> Self {
        let tolerance_db = content.params.reproduced_within_db;
        let compared = |row: &Heading| {
            let pairs = source.columns.iter().zip(row.cells());
            pairs
                .map(|(column, text)| source.compared((row, column), text, content.report, others, tolerance_db))
                .collect()
        };
        let caption = format!("{} of {}: {}", source.number, paper.name, source.caption);
        Self { source, caption, cells: source.rows.iter().map(compared).collect() }
    }

    fn table(&self, content: &Content<'_>) -> Table {
        let shown: Vec<Vec<Beside>> = (0..self.source.columns.len()).map(|column| self.shown(column)).collect();
        let width: usize = 1 + shown.iter().map(Vec::len).sum::<usize>();
        let mut table = if width <= MAX_COLUMNS { self.side_by_side(&shown, content) } else { self.below(content) };
        table.remarks.extend(self.source.notes.iter().map(|note| format!("On {}: {note}.", self.source.number)));
        for heading in self.source.rows.iter().chain(&self.source.columns) {
            table.remarks.extend(heading.notes.iter().map(|note| format!("On {}: {note}.", heading.label)));
        }
        let variants = self.cells.iter().flatten().filter_map(|cell| match cell.measured {
            Some(Measured::Value { variant, .. }) => variant,
            _ => None,
        });
        table.remarks.extend(distinct(variants));
        table
    }

    /// The columns that at least one cell of the printed column needs.
    fn shown(&self, column: usize) -> Vec<Beside> {
        let has = |beside: &Beside| self.cells.iter().any(|row| has(&row[column], *beside));
        let optional = [Beside::Measured, Beside::Verdict, Beside::Others].into_iter().filter(has);
        [Beside::Published].into_iter().chain(optional).collect()
    }

    /// Layout with published, measured, verdict and re-measured values as columns under each printed heading.
    fn side_by_side(&self, shown: &[Vec<Beside>], content: &Content<'_>) -> Table {
        let mut table = Table::new(self.caption.clone(), vec![String::new()]);
        table.groups.push((String::new(), 1));
        for (heading, shown) in self.source.columns.iter().zip(shown) {
            let group = heading.group.as_ref().map(|group| format!("{group} ")).unwrap_or_default();
            table.groups.push((group + &heading.label, shown.len()));
            let is_printed_alone = shown.len() == 1;
            table.header.extend(shown.iter().map(|beside| if is_printed_alone { "" } else { beside.heading() }.into()));
        }
        self.for_rows(&mut table, |table, label, cells| {
            let mut texts = vec![Text::plain(label)];
            for (cell, shown) in cells.iter().zip(shown) {
                texts.extend(shown.iter().map(|beside| text(cell, *beside, content, table)));
            }
            table.rows.push(texts);
        });
        table
    }

    /// Layout with the printed columns, and lines for measured, verdict and re-measured values below each printed row.
    fn below(&self, content: &Content<'_>) -> Table {
        let header = ["".into(), "".into()].into_iter().chain(self.source.columns.iter().map(|c| c.label.clone()));
        let mut table = Table::new(self.caption.clone(), header.collect()).with_text_columns(2);
        table.groups = self.printed_groups();
        self.for_rows(&mut table, |table, label, cells| {
            for beside in [Beside::Published, Beside::Measured, Beside::Verdict, Beside::Others] {
                if beside != Beside::Published && !cells.iter().any(|cell| has(cell, beside)) {
                    continue;
                }
                let texts: Vec<Text> = cells.iter().map(|cell| text(cell, beside, content, table)).collect();
                let lead = [Text::plain(label), Text::plain(beside.heading())];
                table.rows.push(lead.into_iter().chain(texts).collect());
            }
        });
        table
    }

    /// Calls `add` for every row; adds the shared heading before each group of rows.
    fn for_rows(&self, table: &mut Table, mut add: impl FnMut(&mut Table, &str, &[ComparedCell])) {
        let mut group = None;
        for (row, cells) in self.source.rows.iter().zip(&self.cells) {
            if row.group != group {
                group.clone_from(&row.group);
                table.rows.extend(group.iter().map(|group| vec![Text::plain(group)]));
            }
            add(table, &row.label, cells);
        }
    }

    /// The headings over several printed columns; empty if the table has none.
    fn printed_groups(&self) -> Vec<(String, usize)> {
        if self.source.columns.iter().all(|column| column.group.is_none()) {
            return Vec::new();
        }
        let mut groups = vec![(String::new(), 2)];
        for column in &self.source.columns {
            let group = column.group.clone().unwrap_or_default();
            match groups.last_mut() {
                Some((last, columns)) if *last == group && !group.is_empty() => *columns += 1,
                _ => groups.push((group, 1)),
            }
        }
        groups
    }
}

impl Beside {
    fn heading(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Measured => "measured",
            Self::Verdict => "verdict",
            Self::Others => "re-measured",
        }
    }
}

fn has(cell: &ComparedCell, beside: Beside) -> bool {
    match beside {
        Beside::Published => true,
        Beside::Measured => cell.measured.is_some(),
        Beside::Verdict => cell.verdict.is_some(),
        Beside::Others => !cell.others.is_empty(),
    }
}

fn text(cell: &ComparedCell, beside: Beside, content: &Content<'_>, table: &mut Table) -> Text {
    match beside {
        Beside::Published => Text::plain(&cell.printed),
        Beside::Measured => match &cell.measured {
            None => Text::default(),
            Some(Measured::Missing(why)) if why.len() <= MAX_REASON => Text::plain(why),
            Some(Measured::Missing(why)) => Text::plain(format!("{NONE} ({})", table.note(why.clone()))),
            Some(Measured::Value { value, decimals, row, scene, .. }) => {
                let of_scene = scene.as_ref().and_then(|scene| content.traces.scene(row, scene));
                traced(Text::plain(number(*value, *decimals)), of_scene.or_else(|| content.traces.row(row)))
            }
        },
        Beside::Verdict => match &cell.verdict {
            None => Text::default(),
            Some((Verdict::NotComparable, differences)) => {
                let mark = table.note(format!("not comparable: {}", differences.join("; ")));
                Text::plain(format!("not comparable ({mark})"))
            }
            Some((verdict, _)) => Text::plain(verdict.text()),
        },
        Beside::Others => {
            let mut value = |(source, value): &(String, f64)| {
                let mark = table.note(format!("re-measured: {source}"));
                format!("{} ({mark})", number(*value, 2))
            };
            Text::plain(cell.others.iter().map(&mut value).collect::<Vec<_>>().join(", "))
        }
    }
}
