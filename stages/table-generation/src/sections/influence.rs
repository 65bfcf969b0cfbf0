//! The influence of every loss and effect, one table per method.

use training::INERT_SHARE;

use super::cells::{MACHINES_DIFFER, traced};
use super::content::Content;
use crate::column::Column;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::influence::{Influence, PRECISE_DB};
use crate::report::{Group, Row};

/// One table per row with losses or effects.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let groups = content.report.groups.iter();
    let tables = groups.flat_map(|group| {
        let rows = group.rows.iter().filter(|row| !row.influence.is_empty());
        rows.map(|row| Block::Table(influence_table(content, group, row)))
    });
    let mut blocks: Vec<Block> = tables.collect();
    if !blocks.is_empty() {
        blocks.insert(0, Block::Paragraph(explanation()));
    }
    blocks
}

fn explanation() -> String {
    format!(
        "The gradient share of a loss is the norm of its gradient relative to that of the photometric loss, in the group \
         of tensors where it is largest: the median over sampled steps, weighted by the share of steps in which the loss \
         acts. \"Moves only\" names groups that the photometric loss does not reach, if the share is too small in all \
         others: renders do not depend on such a loss. Left out: PSNR, or the metric of a task, without \
         the loss or effect minus that with it, paired by seed; ± is half the 95 % interval, and a difference without ± \
         is from one seed. A loss or an effect is inert if all of these intervals contain 0 and that of PSNR is at most \
         ±{PRECISE_DB} dB wide; a loss also if its share is below {INERT_SHARE} in every group and no interval excludes 0. \
         Seconds of a loss are estimated from its forward pass, where that is timed, and from a separate backward pass; \
         those of an effect are the seconds saved by leaving it out."
    )
}

fn influence_table(content: &Content<'_>, group: &Group, row: &Row) -> Table {
    let measured = |column: &Column| row.influence.iter().any(|influence| influence.left_out.contains_key(column));
    let tasks: Vec<Column> = Column::TASKS.into_iter().filter(measured).collect();
    let left_out = std::iter::once("left out: Δ dB".to_owned());
    let left_out = left_out.chain(tasks.iter().map(|task| format!("left out: Δ {}", task.heading())));
    let header = ["loss or effect", "gradient share", "in group"].map(String::from).into_iter().chain(left_out);
    let header = header.chain(["seconds", "share of training (%)", "verdict"].map(String::from)).collect();
    let caption = format!("Protocol {}: influence in {}", group.name, row.name);
    let mut table = Table::new(caption, header).ending_in_sentences();
    for influence in &row.influence {
        let secs = influence.secs.map_or(NONE.into(), |secs| number(secs, 2));
        let secs_share = influence.secs_share.map_or(NONE.into(), |share| number(100.0 * share, 1));
        let difference = |column: Column, none: &str| {
            influence.left_out.get(&column).map_or(none.to_owned(), |difference| difference.text(column))
        };
        let left_out = std::iter::once(difference(Column::PSNR, "not measured"));
        let left_out = left_out.chain(tasks.iter().map(|&task| difference(task, NONE)));
        let (share, group) = share_text(influence, &row.influence);
        let cells = [share, group].into_iter().chain(left_out).chain([secs, secs_share, verdict(influence)]);
        let cells = cells.map(|cell| traced(Text::plain(cell), content.traces.row(&row.name)));
        table.rows.push([Text::plain(name(influence))].into_iter().chain(cells).collect());
    }
    let compares_times = row.influence.iter().any(|part| !part.is_loss && !part.left_out.is_empty());
    let remark = || format!("{MACHINES_DIFFER}, so the seconds of effects are left out.");
    table.remarks.extend((compares_times && !group.one_machine).then(remark));
    table
}

/// The part, with the effect that a loss belongs to.
fn name(influence: &Influence) -> String {
    match &influence.effect {
        Some(effect) if effect.replace('-', "_") != influence.part => format!("{} ({effect})", influence.part),
        Some(_) => influence.part.clone(),
        None if influence.is_loss => influence.part.clone(),
        None => format!("{} (effect)", influence.part),
    }
}

/// The largest share and its group; `all` are the losses and effects of the row.
fn share_text(influence: &Influence, all: &[Influence]) -> (String, String) {
    let has_losses = || all.iter().any(|other| other.effect.as_deref() == Some(influence.part.as_str()));
    match influence.largest_share() {
        _ if !influence.is_loss && has_losses() => ("see its losses".into(), NONE.into()),
        _ if !influence.is_loss => ("no own loss".into(), NONE.into()),
        _ if influence.samples == 0 => ("not sampled".into(), NONE.into()),
        Some((group, share)) if share >= 0.01 => (number(share, 2), group.into()),
        Some((group, share)) if share > 0.0 => (format!("{share:.0e}"), group.into()),
        _ => ("0".into(), NONE.into()),
    }
}

/// The verdict on a part that is inert, or that moves only groups that the photometric loss does not reach; otherwise empty.
fn verdict(influence: &Influence) -> String {
    let stays = influence.stays.as_ref().map_or(String::new(), |reason| format!("; kept: {reason}"));
    let finding =
        if influence.changes_nothing() { "leaving it out changes nothing" } else { "its gradient is negligible" };
    match influence.secs_share.filter(|_| influence.is_inert) {
        Some(share) => format!("inert: {finding}; {} % of the time{stays}", number(100.0 * share, 1)),
        None if influence.is_inert => format!("inert: {finding}{stays}"),
        None => match influence.alone_in() {
            alone if influence.is_faint() && !alone.is_empty() => format!("moves only {}{stays}", alone.join(", ")),
            _ => String::new(),
        },
    }
}
