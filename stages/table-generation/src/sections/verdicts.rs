//! The verdicts on published values in one table. Sources that are not comparable for the same reason share a row.

use super::content::Content;
use super::published::origin;
use crate::claims::{ClaimColumn, ClaimTable};
use crate::distinct::distinct;
use crate::document::{Table, Text};
use crate::report::Group;

/// A source about a row of the report.
struct Source<'a> {
    /// The row, with the protocol if there are several.
    row: String,
    claims: &'a ClaimTable,
    column: &'a ClaimColumn,
}

/// One line per row and comparable source, then one line per reason why sources are not comparable.
pub(crate) fn table(content: &Content<'_>) -> Option<Table> {
    let tables = content.report.groups.iter().flat_map(|group| group.claims.iter().map(move |claims| (group, claims)));
    let sources = tables.flat_map(|(group, claims)| claims.columns.iter().map(move |column| (group, claims, column)));
    let named = |(group, claims, column): (&Group, _, _)| Source { row: row(content, group, claims), claims, column };
    let (comparable, others): (Vec<_>, Vec<_>) =
        sources.map(named).partition(|source| source.column.differences.is_empty());
    let header = ["method", "source", "origin", "verdict on PSNR"].map(String::from).into();
    let mut table = Table::new("Published values and their reproduction", header).with_text_columns(4);
    for Source { row, claims, column } in &comparable {
        let texts = [named_source(column), origin(column.claim.kind).into(), summary(column, &claims.lines)];
        let first = Text::plain(row).linked(content.traces.row(&claims.row));
        table.rows.push([first].into_iter().chain(texts.map(Text::plain)).collect());
    }
    let reasons: Vec<String> = others.iter().map(|source| source.column.differences.join("; ")).collect();
    for reason in distinct(reasons.iter().map(String::as_str)) {
        let alike = || others.iter().zip(&reasons).filter(|(_, other)| **other == reason).map(|(source, _)| source);
        let joined = |texts: Vec<String>| distinct(texts.iter().map(String::as_str)).join(", ");
        let texts = [
            joined(alike().map(|source| source.row.clone()).collect()),
            joined(alike().map(|source| named_source(source.column)).collect()),
            joined(alike().map(|source| origin(source.column.claim.kind).to_owned()).collect()),
            format!("not comparable: {reason}"),
        ];
        table.rows.push(texts.map(Text::plain).into());
    }
    (!table.rows.is_empty()).then_some(table)
}

fn row(content: &Content<'_>, group: &Group, claims: &ClaimTable) -> String {
    match group.label(content.report) {
        label if label.is_empty() => claims.row.clone(),
        label => format!("{} ({label})", claims.row),
    }
}

fn named_source(column: &ClaimColumn) -> String {
    format!("{} ({})", column.claim.source, column.claim.label)
}

/// Number of reproduced lines, and the lines that are not reproduced.
fn summary(column: &ClaimColumn, lines: &[String]) -> String {
    let entries = || column.entries.iter().zip(lines).filter_map(|(entry, line)| Some((&entry.as_ref()?.1, line)));
    let judged = entries().filter(|(verdict, _)| verdict.is_judged());
    let n_judged = judged.clone().count();
    let n_reproduced = judged.clone().filter(|(verdict, _)| verdict.is_reproduced()).count();
    let others: String = judged
        .filter(|(verdict, _)| !verdict.is_reproduced())
        .map(|(verdict, line)| format!("; {line}: {}", verdict.text()))
        .collect();
    match n_judged {
        0 => "not measured, or measured on other scenes".into(),
        n => format!("{n_reproduced} of {n} reproduced{others}"),
    }
}
