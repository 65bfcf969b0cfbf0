//! Quality per frame: PSNR over time, and the worst frames.

use super::cells::traced;
use super::content::Content;
use crate::collect::{FrameScore, Run};
use crate::document::{Block, Figure, Key, Table, Text};
use crate::format::{NONE, number, signed};
use crate::report::{Group, Row};
use crate::statistics::mean;
use crate::svg::strips::{SCALE, Strips};
use crate::svg::{Panel, scale_sample};

/// Number of lines in the table of worst frames.
const WORST: usize = 10;

/// A figure and a table per group with evaluated images.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut blocks = Vec::new();
    for group in &content.report.groups {
        blocks.extend(figure(content, group).map(Block::Figure));
        let table = worst_table(content, group);
        if !table.rows.is_empty() {
            blocks.push(Block::Table(table));
        }
    }
    blocks
}

fn figure(content: &Content<'_>, group: &Group) -> Option<Figure> {
    let panels: Vec<Panel> = group.scenes.iter().filter_map(|scene| strips(content, group, scene)).collect();
    let label = group.label(content.report);
    let suffix = if label.is_empty() { String::new() } else { format!("-{}", group.name) };
    let sample = scale_sample(SCALE);
    let legend = Key { sample, number: None, label: "PSNR from low (dark) to high (light), per scene".into() };
    (!panels.is_empty()).then(|| Figure {
        file: format!("frames{suffix}.svg"),
        caption: "PSNR of every evaluated image in the order of time, mean over seeds; the values are in frames.csv."
            .into(),
        legend: vec![legend],
        panels,
    })
}

/// A panel with one strip per method.
fn strips(content: &Content<'_>, group: &Group, scene: &str) -> Option<Panel> {
    let rows: Vec<(&Row, Vec<FrameScore>)> =
        group.rows.iter().map(|row| (row, frames(content, group, row, scene))).filter(|(_, f)| !f.is_empty()).collect();
    let all = || rows.iter().flat_map(|(_, frames)| frames).map(|frame| frame.psnr);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let times = || rows.first().map(|(_, frames)| frames.iter().filter_map(|frame| frame.time_secs));
    let end = |time: Option<f64>, name: &str| time.map_or(name.into(), |secs| format!("{} s", number(secs, 2)));
    let ends = [end(times()?.next(), "first"), end(times()?.next_back(), "last")];
    let strip = |(row, frames): &(&Row, Vec<FrameScore>)| {
        let worst = frames.iter().map(|frame| frame.psnr).fold(f64::INFINITY, f64::min);
        let best = frames.iter().map(|frame| frame.psnr).fold(f64::NEG_INFINITY, f64::max);
        let cell = |frame: &FrameScore| (format!("{}: {} dB", frame.name, number(frame.psnr, 2)), frame.psnr);
        let label = format!("{}: {} to {} dB", row.name, number(worst, 1), number(best, 1));
        (label, frames.iter().map(cell).collect())
    };
    let title = format!("{scene}, {} to {} dB", number(low, 1), number(high, 1));
    let strips = Strips { title, ends, range: [low, high], rows: rows.iter().map(strip).collect() };
    (!rows.is_empty()).then(|| strips.panel())
}

/// The frames of a row on a scene in the order of time, mean over seeds without degenerate runs.
fn frames(content: &Content<'_>, group: &Group, row: &Row, scene: &str) -> Vec<FrameScore> {
    let belongs =
        |run: &&Run| run.scene == scene && run.row == row.name && group.holds(run) && run.degenerate.is_none();
    let runs: Vec<&Run> = content.report.runs.iter().filter(belongs).filter(|run| !run.frames.is_empty()).collect();
    let Some(first) = runs.first() else { return Vec::new() };
    let over_seeds = |frame: &FrameScore| {
        let of_run = |run: &&Run| run.frames.iter().find(|other| other.name == frame.name).map(|other| other.psnr);
        let values: Vec<f64> = runs.iter().filter_map(of_run).collect();
        Some(FrameScore { psnr: mean(&values)?, ..frame.clone() })
    };
    let mut frames: Vec<FrameScore> = first.frames.iter().filter_map(over_seeds).collect();
    let time = |frame: &FrameScore| frame.time_secs.unwrap_or(0.0);
    frames.sort_by(|a, b| time(a).total_cmp(&time(b)));
    frames
}

/// The frames farthest below the mean of their method and scene.
fn worst_table(content: &Content<'_>, group: &Group) -> Table {
    let mut worst: Vec<(f64, &Row, &String, FrameScore)> = Vec::new();
    for row in &group.rows {
        for scene in &group.scenes {
            let frames = frames(content, group, row, scene);
            let scores: Vec<f64> = frames.iter().map(|frame| frame.psnr).collect();
            let Some(mean) = mean(&scores) else { continue };
            worst.extend(frames.into_iter().map(|frame| (frame.psnr - mean, row, scene, frame)));
        }
    }
    worst.sort_by(|a, b| a.0.total_cmp(&b.0));
    let header = ["method", "scene", "view", "time (s)", "PSNR (dB)", "difference from the mean"].map(String::from);
    let caption = format!("Protocol {}: frames farthest below the mean of their method and scene", group.name);
    let mut table = Table::new(caption, header.into()).with_text_columns(3);
    for (below, row, scene, frame) in worst.into_iter().filter(|(below, ..)| *below < 0.0).take(WORST) {
        let psnr = traced(Text::plain(number(frame.psnr, 2)), content.traces.scene(&row.name, scene));
        let time = frame.time_secs.map_or(NONE.into(), |secs| number(secs, 2));
        let lead = [&row.name, scene, &frame.name, &time].map(Text::plain);
        table.rows.push(lead.into_iter().chain([psnr, Text::plain(signed(below, 2))]).collect());
    }
    table
}
