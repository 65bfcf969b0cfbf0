//! The summary in sentences: number of runs, best methods, precision of their differences, reproduced values.

use std::collections::BTreeMap;

use engine::count;

use super::content::Content;
use crate::collect::FINISHED;
use crate::column::Column;
use crate::difference::Difference;
use crate::distinct::distinct;
use crate::document::Block;
use crate::format::number;
use crate::ranks::{complete_seeds, seeds_of};
use crate::report::{Group, Report};

/// Number of degenerate runs that the summary names.
const NAMED: usize = 6;

/// Sentences about runs, leaders, noise and published values.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut sentences = vec![outcomes(content.report)];
    sentences.extend(degenerate(content.report));
    sentences.extend(content.report.groups.iter().flat_map(|group| [best(group), noise(group)]));
    sentences.push(published(content.report));
    sentences.into_iter().map(Block::Paragraph).collect()
}

/// Number of finished runs, and of the others by outcome.
fn outcomes(report: &Report) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for run in &report.runs {
        *counts.entry(run.outcome()).or_default() += 1;
    }
    let n_finished = counts.remove(FINISHED).unwrap_or(0);
    let others: String = counts.iter().map(|(what, count)| format!(", {count} × {what}")).collect();
    format!("{}: {n_finished} finished{others}.", count(report.runs.len(), "run"))
}

/// Names the degenerate runs; none if there are none.
fn degenerate(report: &Report) -> Option<String> {
    let runs = report.runs.iter().filter(|run| run.degenerate.is_some());
    let names: Vec<String> = runs.map(|run| format!("{} on {}", run.row, run.scene)).collect();
    let names = distinct(names.iter().map(String::as_str));
    let shown = names.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ");
    let more = if names.len() > NAMED { format!(" and {} more", names.len() - NAMED) } else { String::new() };
    (!names.is_empty()).then(|| {
        format!(
            "Degenerate, i.e. no better than an image that needs no model: {shown}{more}; see \"Failures\" for causes."
        )
    })
}

/// The best methods in quality, training time and speed, with the methods that are not distinguishable from them.
fn best(group: &Group) -> String {
    let leader = |column: Column, what: &str, unit: &str| {
        let cells = || group.rows.iter().filter_map(|row| Some((row.name.as_str(), row.headline.get(&column)?)));
        let best: Vec<_> = cells().filter(|(_, cell)| cell.rank == Some(1)).collect();
        let value = best.first()?.1.mean?;
        let text = |value| number(value, column.decimals());
        let tied = || cells().filter(|(_, cell)| cell.within_noise);
        let seeds = tied().filter_map(|(_, cell)| Difference::of(cell, best.first()?.1)).map(|tie| tie.seeds).min();
        let tied: Vec<String> =
            tied().filter_map(|(name, cell)| Some(format!("{name} {}", text(cell.mean?)))).collect();
        let names: Vec<&str> = best.iter().map(|(name, _)| *name).collect();
        let tie = seeds.map(|seeds| format!("; not distinguishable with {seeds} seeds: {}", tied.join(", ")));
        let tie = tie.unwrap_or_default();
        Some(format!("{what}: {} ({} {unit}{tie})", names.join(", "), text(value)))
    };
    let leaders = [
        leader(Column::PSNR, "highest PSNR", "dB"),
        leader(Column::TrainingSecs, "shortest training", "s"),
        leader(Column::FpsModel, "fastest rendering", "frames per second"),
    ];
    let leaders: Vec<String> = leaders.into_iter().flatten().collect();
    let leaders = if leaders.is_empty() { "nothing to rank".into() } else { leaders.join("; ") };
    let [width, height] = [group.protocol.width, group.protocol.height];
    let about = format!("Protocol {} ({}, {width}×{height})", group.name, group.protocol.dataset);
    format!("{about}: {leaders}.{}", incomplete(group))
}

/// Names the rows without a rank in PSNR because they lack seeds that others have.
fn incomplete(group: &Group) -> String {
    let cells = || group.rows.iter().filter_map(|row| Some((&row.name, row.headline.get(&Column::PSNR)?)));
    let complete = complete_seeds(cells().map(|(_, cell)| cell));
    let lacking = cells().filter(|(_, cell)| cell.n() > 0 && seeds_of(cell) != complete);
    let (fewer, other): (Vec<_>, Vec<_>) = lacking.partition(|(_, cell)| cell.n() < complete.len());
    let sentence = |reason: &str, rows: Vec<String>| match &rows[..] {
        [] => String::new(),
        rows => format!(" Not ranked, because {reason}: {}.", rows.join(", ")),
    };
    let most = complete.len();
    let fewer = fewer.iter().map(|(name, cell)| format!("{name} ({} of {most} seeds)", cell.n())).collect();
    let other = other.iter().map(|(name, cell)| format!("{name} (seeds {})", cell.seeds.join(", "))).collect();
    let seeds = complete.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    sentence("others have more seeds", fewer) + &sentence(&format!("ranks are over the seeds {seeds}"), other)
}

/// A sentence about the precision of the differences in PSNR.
fn noise(group: &Group) -> String {
    let name = &group.name;
    let cells = || group.rows.iter().filter_map(|row| Some((row.name.as_str(), row.headline.get(&Column::PSNR)?)));
    if group.rows.len() < 2 {
        return format!("Protocol {name} has one method: nothing to compare.");
    }
    if cells().all(|(_, cell)| cell.n_expected < 2) {
        return format!("Protocol {name}: there is one seed per run, so differences between methods prove nothing.");
    }
    let best = cells().find(|(_, cell)| cell.rank == Some(1));
    let others = cells().filter(|(row, _)| best.is_none_or(|(best, _)| *row != best));
    let (known, unknown): (Vec<_>, Vec<_>) = others
        .map(|(row, cell)| (row, best.and_then(|(_, best)| Difference::of(cell, best))))
        .partition(|(_, difference)| difference.is_some_and(|difference| difference.half_width.is_some()));
    let width = known.iter().filter_map(|(_, difference)| difference.as_ref()?.half_width).reduce(f64::max);
    let seeds = known.iter().filter_map(|(_, difference)| Some(difference.as_ref()?.seeds)).min();
    let (Some(width), Some(seeds)) = (width, seeds) else {
        return format!(
            "Protocol {name}: fewer than two seeds in common with the best method, so differences from it prove nothing."
        );
    };
    let unknown: Vec<&str> = unknown.into_iter().map(|(row, _)| row).collect();
    let unknown = match &unknown[..] {
        [] => String::new(),
        rows => format!(" Exceptions, with fewer than two seeds in common with the best: {}.", rows.join(", ")),
    };
    format!(
        "With {seeds} seeds, paired differences in mean PSNR from the best method are known to ± {} dB or better under \
         protocol {name} (95 %).{unknown}",
        number(width, 2)
    )
}

/// The number of comparable published tables, and of their reproduced and undecided values.
fn published(report: &Report) -> String {
    let columns = || report.groups.iter().flat_map(|group| &group.claims).flat_map(|table| &table.columns);
    let n_sources = columns().count();
    if report.groups.is_empty() {
        return "Nothing was measured.".into();
    }
    if n_sources == 0 {
        return "No published values are available for these methods and scenes.".into();
    }
    let comparable = || columns().filter(|column| column.differences.is_empty());
    let verdicts = || comparable().flat_map(|column| &column.entries).flatten().map(|(_, verdict)| verdict);
    let n_judged = verdicts().filter(|verdict| verdict.is_judged()).count();
    let n_reproduced = verdicts().filter(|verdict| verdict.is_reproduced()).count();
    let undecided = match verdicts().filter(|verdict| verdict.is_undecided()).count() {
        0 => String::new(),
        n => format!(", {n} undecided (within spread: the interval is wider than the tolerance)"),
    };
    let judged = match n_judged {
        0 => String::new(),
        n => format!("; {n_reproduced} of {n} values are reproduced{undecided}"),
    };
    format!("Published values: {} of {n_sources} sources are comparable{judged}.", comparable().count())
}
