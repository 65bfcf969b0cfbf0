//! Results per protocol: means, values per scene, gains over the baseline, and metrics that few captures provide.

use std::collections::{BTreeMap, BTreeSet};

use engine::count;
use metric_evaluation::{Metric, Trivial};

use super::cells::{explain_marks, explain_ranks, mean_text, scene_cells, traced};
use super::content::Content;
use super::prompts;
use crate::cell::Cells;
use crate::collect::failure_mark;
use crate::column::{Column, Masked};
use crate::difference::{Difference, REMARK};
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::pairs::{with_baseline, with_bases, without_base};
use crate::report::{FailedRun, Group, Report, Row};
use crate::statistics::mean;

/// The row of images that show the mean of the others.
const MEAN_IMAGE: &str = "mean of the other images";

/// The results of all groups.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut blocks = Vec::new();
    if content.report.groups.is_empty() {
        blocks.push(Block::Paragraph("No run was measured; see the failures below.".into()));
    }
    blocks.extend(unjudged_scenes(content.report).map(Block::Paragraph));
    for group in &content.report.groups {
        blocks.push(Block::Heading(format!("Protocol {}: {}", group.name, group.protocol.dataset)));
        blocks.push(Block::Paragraph(protocol_text(group, content.report)));
        blocks.extend(mean_tables(content, group).into_iter().map(Block::Table));
        blocks.push(Block::Table(scene_table(content, group, Column::PSNR)));
        blocks.extend(gain_tables(content, group).into_iter().flatten().map(Block::Table));
        blocks.extend(missing_references(content, group).into_iter().map(Block::Paragraph));
        blocks.extend(conditional_tables(content, group).map(Block::Table));
        blocks.extend(prompts::table(content, group).map(Block::Table));
    }
    blocks
}

/// Names the scenes that no table contains because all of their runs failed. Missing data is reported elsewhere.
fn unjudged_scenes(report: &Report) -> Option<String> {
    let is_tabulated = |scene: &String| report.groups.iter().any(|group| group.scenes.contains(scene));
    let unjudged = report.failures.iter().filter(|failed| !is_tabulated(&failed.scene));
    let named = |failed: &FailedRun| format!("{} ({})", failed.scene, failure_mark(failed.failure.kind));
    let scenes: Vec<String> = unjudged.map(named).collect();
    let scenes = distinct(scenes.iter().map(String::as_str));
    let anything = !scenes.is_empty() && !report.groups.is_empty();
    anything.then(|| {
        format!("Left out of all tables and means because no image could be evaluated: {}.", scenes.join(", "))
    })
}

/// The protocol in one line, the scenes of the means, and the scenes of the same data set under other protocols.
fn protocol_text(group: &Group, report: &Report) -> String {
    let scenes = format!("{} ({})", count(group.scenes.len(), "scene"), group.scenes.join(", "));
    let is_sibling = |other: &&Group| other.name != group.name && other.protocol.dataset == group.protocol.dataset;
    let siblings = report.groups.iter().filter(is_sibling);
    let siblings: String = siblings
        .map(|other| format!(" Under another protocol: {} (protocol {}).", other.scenes.join(", "), other.name))
        .collect();
    format!("{} · {}. Means over {scenes}.{siblings}", group.protocol.line(), group.judged_by)
}

/// Means over all scenes, and over the subsets of them that have means.
fn mean_tables(content: &Content<'_>, group: &Group) -> Vec<Table> {
    let mut whole =
        mean_table(content, group, format!("means over {}", count(group.scenes.len(), "scene")), |row| &row.headline);
    whole.remarks.extend(unmeasured(group));
    explain_ranks(&mut whole, group.rows.len());
    let of_part = |(at, part): (usize, &crate::report::ScenePart)| {
        mean_table(
            content,
            group,
            format!("means over {} ({})", count(part.scenes.len(), "scene"), part.name),
            move |row| &row.parts[at],
        )
    };
    [whole].into_iter().chain(group.parts.iter().enumerate().map(of_part)).collect()
}

fn mean_table<'g>(
    content: &Content<'_>,
    group: &'g Group,
    what: String,
    cells_of: impl Fn(&'g Row) -> &'g Cells,
) -> Table {
    let columns: Vec<Column> = Column::HEADLINE.into_iter().filter(|column| is_measured(group, *column)).collect();
    let headings = columns.iter().map(|column| column.heading());
    let header = ["method".into()].into_iter().chain(headings).chain(["seeds".into()]).collect();
    let mut table = Table::new(format!("Protocol {}: {what}", group.name), header);
    for row in &group.rows {
        let cells = cells_of(row);
        let n_seeds = cells.values().map(|cell| cell.n_expected).max().unwrap_or(0);
        let mut texts = vec![Text::plain(&row.name)];
        for column in &columns {
            let text = mean_text(cells, *column, &mut table);
            texts.push(traced(text, content.traces.row(&row.name)));
        }
        texts.push(Text::plain(n_seeds.to_string()));
        table.rows.push(texts);
    }
    explain_marks(&mut table);
    table.remarks.extend(shortened(group));
    table
}

/// Whether a row has a value of the column in a scene.
fn is_measured(group: &Group, column: Column) -> bool {
    let cells = group.rows.iter().flat_map(|row| row.by_scene.values());
    cells.filter_map(|cells| cells.get(&column)).any(|cell| cell.mean.is_some())
}

/// Names the headline columns without any value, and the reasons with their scenes; equal reasons share an entry.
fn unmeasured(group: &Group) -> Option<String> {
    let mut entries: Vec<(String, Vec<String>)> = Vec::new();
    for column in Column::HEADLINE.into_iter().filter(|column| !is_measured(group, *column)) {
        let why = reasons(group, column);
        match entries.iter_mut().find(|(other, _)| *other == why) {
            Some((_, headings)) => headings.push(column.heading()),
            None => entries.push((why, vec![column.heading()])),
        }
    }
    let entries: Vec<String> =
        entries.into_iter().map(|(why, headings)| format!("{} ({why})", headings.join(", "))).collect();
    (!entries.is_empty()).then(|| format!("Without any value: {}.", entries.join("; ")))
}

/// The reasons why the cells of a column have no value, each with its scenes. Where any row finished, those that did not are
/// ignored: they lack every metric, which explains nothing about this one.
fn reasons(group: &Group, column: Column) -> String {
    let is_finished = |cells: &Cells| cells.get(&Column::PSNR).is_some_and(|cell| cell.mean.is_some());
    let mut scenes: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for scene in &group.scenes {
        let rows = || group.rows.iter().filter_map(|row| row.by_scene.get(scene));
        let any_finished = rows().any(is_finished);
        for cells in rows().filter(|cells| !any_finished || is_finished(cells)) {
            let reason = cells.get(&column).and_then(|cell| cell.reason.as_deref());
            scenes.entry(reason.unwrap_or("not measured")).or_default().insert(scene);
        }
    }
    let of = |(reason, scenes): (&str, BTreeSet<&str>)| {
        let is_everywhere = scenes.len() == group.scenes.len();
        let names = if is_everywhere { "all scenes".into() } else { Vec::from_iter(scenes).join(", ") };
        format!("{names}: {reason}")
    };
    scenes.into_iter().map(of).collect::<Vec<_>>().join("; ")
}

/// Names the rows that were not trained with their method's own schedule, one line per difference.
fn shortened(group: &Group) -> impl Iterator<Item = String> {
    let ways = distinct(group.rows.iter().filter_map(|row| row.shortened.as_deref()));
    ways.into_iter().map(|way| {
        let rows = group.rows.iter().filter(|row| row.shortened.as_ref() == Some(&way));
        let rows: Vec<&str> = rows.map(|row| row.name.as_str()).collect();
        let names = if rows.len() == group.rows.len() { "all methods".into() } else { rows.join(", ") };
        format!("Not the methods' own schedules: {way} ({names}).")
    })
}

/// Scenes whose mean has a column.
struct MeanSet<'g> {
    heading: String,
    scenes: &'g [String],
    /// The index of the part; none for all scenes.
    part: Option<usize>,
}

impl MeanSet<'_> {
    fn cells<'r>(&self, row: &'r Row) -> &'r Cells {
        self.part.map_or(&row.headline, |part| &row.parts[part])
    }
}

/// All scenes and each part of them; the mean of a single scene would repeat its column.
fn mean_sets(group: &Group) -> Vec<MeanSet<'_>> {
    let all = MeanSet { heading: format!("mean of {}", group.scenes.len()), scenes: &group.scenes, part: None };
    let parts = group.parts.iter().enumerate().map(|(at, part)| MeanSet {
        heading: format!("mean of {} ({})", part.scenes.len(), part.name),
        scenes: &part.scenes,
        part: Some(at),
    });
    [all].into_iter().chain(parts).filter(|set| set.scenes.len() > 1).collect()
}

/// One metric: a column per scene, and a column per mean of several scenes.
fn scene_table(content: &Content<'_>, group: &Group, column: Column) -> Table {
    let sets = mean_sets(group);
    let means = sets.iter().map(|set| set.heading.clone());
    let header = ["method".into()].into_iter().chain(group.scenes.iter().cloned()).chain(means).collect();
    let mut table = Table::new(format!("Protocol {}: {} per scene", group.name, column.heading()), header);
    for row in &group.rows {
        let mut cells = scene_cells(content, row, &group.scenes, column);
        for set in &sets {
            let text = mean_text(set.cells(row), column, &mut table);
            cells.push(traced(text, content.traces.row(&row.name)));
        }
        table.rows.push(cells);
    }
    if column == Column::PSNR {
        table.rows.extend(trivial_rows(group, &sets));
    }
    explain_marks(&mut table);
    table
}

/// The PSNR of images that need no model, per scene and as means over the same scenes as the methods' means.
fn trivial_rows(group: &Group, sets: &[MeanSet<'_>]) -> Vec<Vec<Text>> {
    let constant = |trivial: &Trivial| Some(trivial.constant_psnr);
    let mean_image = |trivial: &Trivial| trivial.mean_image.map(|mean| mean.psnr);
    let row = |name: &str, psnr: &dyn Fn(&Trivial) -> Option<f64>| -> Vec<Text> {
        let of_scene = |scene: &String| psnr(group.trivial.get(scene)?);
        let of_set = |set: &MeanSet<'_>| mean(&set.scenes.iter().map(of_scene).collect::<Option<Vec<f64>>>()?);
        let values = group.scenes.iter().map(of_scene).chain(sets.iter().map(of_set));
        let texts = values.map(|value| value.map_or(NONE.into(), |value| number(value, Column::PSNR.decimals())));
        [name.to_owned()].into_iter().chain(texts).map(Text::plain).collect()
    };
    if group.trivial.is_empty() {
        return Vec::new();
    }
    vec![row("best constant image", &constant), row(MEAN_IMAGE, &mean_image)]
}

/// Notes about the baseline and the bases that were not measured, if several other rows were.
fn missing_references(content: &Content<'_>, group: &Group) -> Vec<String> {
    let baseline = &content.params.baseline;
    let is_measured = group.rows.iter().any(|row| row.method == *baseline);
    let note = |with: &str, reference: &str| {
        format!("No comparison with {with}: no run of {reference} was measured under this protocol.")
    };
    let of_baseline = (!is_measured).then(|| note("the baseline", baseline));
    let bases = without_base(group, content.params).into_iter();
    let of_bases = bases.map(|(method, base)| note(&format!("the base of {method}"), &base));
    of_baseline.into_iter().chain(of_bases).filter(|_| group.rows.len() > 1).collect()
}

/// The gains over the baseline and over the base of each method. The caption names the row of the baseline; if there is one for
/// each value of an axis, every line names its own.
fn gain_tables(content: &Content<'_>, group: &Group) -> [Option<Table>; 2] {
    let both = |row: &Row, reference: &Row| format!("{} − {}", row.name, reference.name);
    let caption = |reference: &str| format!("Protocol {}: gain in PSNR over {reference} (dB)", group.name);
    let over_baseline = with_baseline(group, content.params);
    let baselines = distinct(over_baseline.iter().map(|(_, baseline)| baseline.name.as_str()));
    let over_bases = with_bases(group, content.params);
    [
        match &baselines[..] {
            [one] => gain_table(content, group, caption(one), &over_baseline, |row, _| row.name.clone()),
            _ => gain_table(content, group, caption(&content.params.baseline), &over_baseline, both),
        },
        gain_table(content, group, caption("the base of each method"), &over_bases, both),
    ]
}

/// Paired differences in PSNR of pairs of rows, per scene and over all scenes; none without pairs.
fn gain_table(
    content: &Content<'_>,
    group: &Group,
    caption: String,
    pairs: &[(&Row, &Row)],
    name: impl Fn(&Row, &Row) -> String,
) -> Option<Table> {
    let has_mean = group.scenes.len() > 1;
    let ends = has_mean.then_some("mean").into_iter().chain(["scenes with a gain beyond noise"]).map(String::from);
    let header = ["method".into()].into_iter().chain(group.scenes.iter().cloned()).chain(ends);
    let mut table = Table::new(caption, header.collect());
    for (row, reference) in pairs {
        let cell = |row: &Row, scene: &String| row.by_scene.get(scene)?.get(&Column::PSNR).cloned();
        let gain = |scene| Difference::of(&cell(row, scene)?, &cell(reference, scene)?);
        let gains: Vec<Option<Difference>> = group.scenes.iter().map(gain).collect();
        let text = |gain: Option<Difference>| {
            Text::plain(gain.map_or(NONE.into(), |gain: Difference| gain.text(Column::PSNR)))
        };
        let by_scene = gains.iter().zip(&group.scenes);
        let texts = by_scene.map(|(gain, scene)| traced(text(*gain), content.traces.scene(&row.name, scene)));
        let over_all = Difference::of_column(&row.headline, &reference.headline, Column::PSNR);
        let mean = has_mean.then(|| traced(text(over_all), content.traces.row(&row.name)));
        let count = Text::plain(beyond_noise(&gains));
        table
            .rows
            .push([Text::plain(name(row, reference))].into_iter().chain(texts).chain(mean).chain([count]).collect());
    }
    table.remarks.extend(
        [REMARK, "A gain beyond noise has an interval above 0; scenes with one seed are not counted."]
            .map(String::from),
    );
    (!table.rows.is_empty()).then_some(table)
}

/// The number of scenes whose interval is above 0, of those with several seeds: one seed proves nothing.
fn beyond_noise(gains: &[Option<Difference>]) -> String {
    let with_interval: Vec<_> = gains.iter().flatten().filter(|gain| gain.half_width.is_some()).collect();
    let n_above = with_interval.iter().filter(|gain| gain.mean > 0.0 && !gain.is_noise()).count();
    if with_interval.is_empty() { NONE.into() } else { format!("{n_above} of {}", with_interval.len()) }
}

/// One table per conditional metric that any run has, over the scenes and methods that define it.
fn conditional_tables(content: &Content<'_>, group: &Group) -> impl Iterator<Item = Table> {
    Column::conditional().filter_map(|column| {
        let mean = |row: &Row, scene: &String| row.by_scene.get(scene)?.get(&column)?.mean;
        let in_scene = |scene: &&String| group.rows.iter().any(|row| mean(row, scene).is_some());
        let scenes: Vec<String> = group.scenes.iter().filter(in_scene).cloned().collect();
        let rows = group.rows.iter().filter(|row| scenes.iter().any(|scene| mean(row, scene).is_some()));
        let header = ["method".into()].into_iter().chain(scenes.iter().cloned()).collect();
        let better = if column.higher_is_better() { "higher" } else { "lower" };
        let caption = format!("Protocol {}: {} per scene ({better} is better)", group.name, column.heading());
        let mut table = Table::new(caption, header);
        table.rows = rows.map(|row| scene_cells(content, row, &scenes, column)).collect();
        table.rows.extend(trivial_row(group, &scenes, column));
        explain_marks(&mut table);
        (!scenes.is_empty()).then_some(table)
    })
}

/// The scores of an answer that needs no model, per scene: of renders without motion in a metric of motion, of the mean of
/// the other images in a masked metric and on moving surfaces.
fn trivial_row(group: &Group, scenes: &[String], column: Column) -> Option<Vec<Text>> {
    let of_scene = |trivial: &Trivial| match column {
        Column::Metric(metric) => {
            trivial.without_motion.get(&metric).or_else(|| trivial.moving_mean_image.get(&metric)).copied()
        }
        Column::Masked(Masked { metric, mask }) => trivial.masked_mean_image.get(&mask)?.get(&metric).copied(),
        _ => None,
    };
    let is_of_mean_image =
        matches!(column, Column::Masked(_) | Column::Metric(Metric::PsnrMoving | Metric::PsnrEmerging));
    let name = if is_of_mean_image { MEAN_IMAGE } else { "without motion" };
    let score = |scene: &String| of_scene(group.trivial.get(scene)?);
    scenes.iter().any(|scene| score(scene).is_some()).then(|| {
        let texts =
            scenes.iter().map(|scene| score(scene).map_or(NONE.into(), |score| number(score, column.decimals())));
        [name.into()].into_iter().chain(texts).map(Text::plain).collect()
    })
}
