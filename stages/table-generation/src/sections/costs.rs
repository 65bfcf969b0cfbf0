//! Training costs: seconds by activity, milliseconds per iteration by phase, share and time of each loss, skipped work,
//! values that parts of methods report, and the placement of particles.

use std::collections::{BTreeMap, BTreeSet};

use super::cells::traced;
use super::content::Content;
use crate::document::{Block, Figure, Key, Table, Text};
use crate::format::{NONE, number};
use crate::report::{Group, Row};
use crate::svg::area_sample;
use crate::svg::bars::Bars;

/// Activities of training in the order of a step; other activities follow in alphabetical order.
const ACTIVITIES: [&str; 10] =
    ["load", "motion", "projection", "sort", "blend", "losses", "backward", "optimizer", "density", "evaluation"];
/// Activities that are not part of training.
const UNCLOCKED: [&str; 2] = ["evaluation", "influence"];

/// A figure and up to six tables per group.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut blocks = Vec::new();
    for group in &content.report.groups {
        blocks.extend(phase_figure(content, group).map(Block::Figure));
        let tables = [phase_table, iteration_table, loss_table, skipped_table, figure_table, particle_table]
            .map(|table| table(content, group));
        blocks.extend(tables.into_iter().filter(|table| !table.rows.is_empty()).map(Block::Table));
    }
    blocks
}

/// The activities that any row measured.
fn activities(group: &Group) -> Vec<&str> {
    in_order(group.rows.iter().flat_map(|row| row.phases.keys().map(String::as_str)).collect())
}

/// The known activities in the order of a step, then the others.
fn in_order(names: BTreeSet<&str>) -> Vec<&str> {
    let known = ACTIVITIES.into_iter().filter(|activity| names.contains(activity));
    known.chain(names.iter().copied().filter(|name| !ACTIVITIES.contains(name))).collect()
}

/// Seconds by activity as bars, without those that are not part of training.
fn phase_figure(content: &Content<'_>, group: &Group) -> Option<Figure> {
    let drawn: Vec<&str> = activities(group).into_iter().filter(|activity| !UNCLOCKED.contains(activity)).collect();
    let bar = |row: &Row| {
        let segments = drawn.iter().map(|activity| row.phases.get(*activity).copied().unwrap_or(0.0)).collect();
        (row.name.clone(), segments)
    };
    let rows: Vec<(String, Vec<f64>)> = group.rows.iter().filter(|row| !row.phases.is_empty()).map(bar).collect();
    if rows.is_empty() {
        return None;
    }
    let label = group.label(content.report);
    let suffix = if label.is_empty() { String::new() } else { format!("-{}", group.name) };
    let title = if label.is_empty() { "seconds of training".into() } else { format!("seconds of training ({label})") };
    let legend = drawn.iter().enumerate().map(|(at, activity)| Key {
        sample: area_sample(at),
        number: Some(at + 1),
        label: (*activity).to_owned(),
    });
    Some(Figure {
        file: format!("costs{suffix}.svg"),
        caption: "Seconds of training by activity, mean over runs; evaluation excluded.".into(),
        legend: legend.collect(),
        panels: vec![Bars { title, x_label: "seconds".into(), rows }.panel()],
    })
}

/// A line of a table: its name, and values linked to the runs of the row.
fn line(content: &Content<'_>, row: &Row, name: String, values: impl Iterator<Item = String>) -> Vec<Text> {
    let values = values.map(|value| traced(Text::plain(value), content.traces.row(&row.name)));
    [Text::plain(name)].into_iter().chain(values).collect()
}

/// Seconds by activity as numbers.
fn phase_table(content: &Content<'_>, group: &Group) -> Table {
    let activities = activities(group);
    let heading = |activity: &&str| match UNCLOCKED.contains(activity) {
        true => format!("{activity} (excluded)"),
        false => (*activity).to_owned(),
    };
    let header = ["method".to_owned()].into_iter().chain(activities.iter().map(heading)).collect();
    let caption = format!("Protocol {}: seconds of training by activity, mean over runs", group.name);
    let mut table = Table::new(caption, header);
    for row in group.rows.iter().filter(|row| !row.phases.is_empty()) {
        let secs = |activity: &&str| row.phases.get(*activity).map_or(NONE.into(), |secs| number(*secs, 1));
        table.rows.push(line(content, row, row.name.clone(), activities.iter().map(secs)));
    }
    table
}

/// Milliseconds per iteration: a row per method and phase, a column per activity.
fn iteration_table(content: &Content<'_>, group: &Group) -> Table {
    let phases = group.rows.iter().flat_map(|row| row.costs.ms_per_iteration_by_phase.values());
    let names = in_order(phases.flat_map(BTreeMap::keys).map(String::as_str).collect());
    let header = ["method · phase", "all"].into_iter().chain(names.iter().copied()).map(String::from).collect();
    let caption = format!("Protocol {}: milliseconds per iteration by phase, mean over runs", group.name);
    let mut table = Table::new(caption, header);
    for row in &group.rows {
        for (phase, activities) in &row.costs.ms_per_iteration_by_phase {
            let all: f64 = activities.values().sum();
            let cells = names.iter().map(|name| activities.get(*name).map_or(NONE.into(), |ms| number(*ms, 2)));
            let name = format!("{} · {phase}", row.name);
            table.rows.push(line(content, row, name, [number(all, 2)].into_iter().chain(cells)));
        }
    }
    table
}

/// Share of the total loss and seconds of the forward pass, per loss.
fn loss_table(content: &Content<'_>, group: &Group) -> Table {
    let header =
        ["method · loss", "share of the total value (%)", "forward (s)", "backward alone (s)"].map(String::from);
    let mut table = Table::new(format!("Protocol {}: losses, mean over runs", group.name), header.into());
    // A single loss has a share of 100 %.
    for row in group.rows.iter().filter(|row| row.costs.loss_shares.len() > 1) {
        for (name, share) in &row.costs.loss_shares {
            let secs = |secs: Option<f64>| secs.map_or(NONE.into(), |secs| number(secs, 2));
            let [forward, backward] = [share.forward_secs, share.backward_secs].map(secs);
            let cells = [number(100.0 * share.value_share, 2), forward, backward];
            table.rows.push(line(content, row, format!("{} · {name}", row.name), cells.into_iter()));
        }
    }
    table
}

/// Number of skipped and of all items, per kind of work that is skipped where the scene does not need it.
fn skipped_table(content: &Content<'_>, group: &Group) -> Table {
    let header = ["method · work", "skipped", "total", "share (%)"].map(String::from);
    let caption = format!("Protocol {}: skipped work, sum over runs", group.name);
    let mut table = Table::new(caption, header.into());
    for row in &group.rows {
        for (work, [skipped, total]) in &row.costs.skipped_work {
            let share = 100.0 * *skipped as f64 / (*total).max(1) as f64;
            let cells = [skipped.to_string(), total.to_string(), number(share, 1)];
            table.rows.push(line(content, row, format!("{} · {work}", row.name), cells.into_iter()));
        }
    }
    table
}

/// Values that the parts of a method report for its trained models.
fn figure_table(content: &Content<'_>, group: &Group) -> Table {
    let caption = format!("Protocol {}: parts of methods after training, mean over runs", group.name);
    let mut table = Table::new(caption, ["method · figure", "mean"].map(String::from).into());
    for row in &group.rows {
        for (name, figure) in &row.costs.figures {
            let cells = [number(*figure, 2)];
            table.rows.push(line(content, row, format!("{} · {name}", row.name), cells.into_iter()));
        }
    }
    table
}

/// Moving share of the sampled surface and of the particles.
fn particle_table(content: &Content<'_>, group: &Group) -> Table {
    let header = ["method", "moving share of the area (%)", "moving share of the particles (%)"].map(String::from);
    let caption = format!("Protocol {}: particles on moving surfaces, mean over runs", group.name);
    let mut table = Table::new(caption, header.into());
    for row in &group.rows {
        if let Some(shares) = row.costs.particles_moving {
            let cells = [shares.of_area, shares.of_particles].map(|share| number(100.0 * share, 1));
            table.rows.push(line(content, row, row.name.clone(), cells.into_iter()));
        }
    }
    table
}
