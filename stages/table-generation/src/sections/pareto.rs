//! Accuracy versus cost: seconds of training, and frames per second.

use engine::count;

use super::cells::{MACHINES_DIFFER, traced};
use super::content::Content;
use crate::cell::Cell;
use crate::column::Column;
use crate::document::{Block, Figure, Key, Table, Text};
use crate::format::{NONE, number};
use crate::ranks::{complete_seeds, seeds_of};
use crate::report::{Group, Row};
use crate::svg::line_sample;
use crate::svg::scatter::{Point, Scatter};

/// Cost columns with their axis labels: seconds (lower is better) and frames per second (higher is better).
const COSTS: [(Column, &str); 2] =
    [(Column::TrainingSecs, "training time (s, log)"), (Column::FpsModel, "FPS model (log)")];

/// A figure and a table per group with quality and costs.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    content.report.groups.iter().flat_map(|group| group_blocks(content, group)).collect()
}

fn group_blocks(content: &Content<'_>, group: &Group) -> Vec<Block> {
    let drawn = COSTS.map(|(cost, label)| (cost, label, points(group, cost)));
    if drawn.iter().all(|(_, _, points)| points.is_empty()) {
        return Vec::new();
    }
    let table = front_table(content, group, &drawn);
    let title = |cost: Column| match (cost, group.label(content.report)) {
        (Column::TrainingSecs, label) if label.is_empty() => "quality over training time".to_owned(),
        (_, label) if label.is_empty() => "quality over speed".to_owned(),
        (Column::TrainingSecs, label) => format!("quality over training time ({label})"),
        (_, label) => format!("quality over speed ({label})"),
    };
    let panels = drawn.into_iter().filter(|(_, _, points)| !points.is_empty()).map(|(cost, label, points)| {
        let scatter = Scatter { title: title(cost), x_label: label.into(), y_label: "test PSNR (dB)".into(), points };
        scatter.panel()
    });
    let suffix = if content.report.groups.len() > 1 { format!("-{}", group.name) } else { String::new() };
    let figure = Figure {
        file: format!("pareto{suffix}.svg"),
        caption: format!(
            "Means over {}. {} Crosses: standard deviation over seeds; dots: single seeds.",
            count(group.scenes.len(), "scene"),
            front(group)
        ),
        legend: legend(group),
        panels: panels.collect(),
    };
    vec![Block::Figure(figure), Block::Table(table)]
}

/// The legend: number, marker and name of every row.
pub(crate) fn legend(group: &Group) -> Vec<Key> {
    let key = |(style, row): (usize, &Row)| Key {
        sample: line_sample(style),
        number: Some(style + 1),
        label: row.name.clone(),
    };
    group.rows.iter().enumerate().map(key).collect()
}

/// Explains the front, or why there is none.
fn front(group: &Group) -> String {
    if !group.one_machine {
        return format!("{MACHINES_DIFFER}, so there is no Pareto front.");
    }
    "Filled markers and the dotted line are the Pareto front: no other method is better in one value and at least as good in \
     the other."
        .into()
}

/// A point per row that has both quality and cost. A row that lacks seeds of others is not on the front; none is if costs were
/// measured on several kinds of machines.
fn points(group: &Group, cost: Column) -> Vec<Point> {
    let cells = |row: &'_ Row| -> Option<[Cell; 2]> {
        let [cost, quality] = [cost, Column::PSNR].map(|column| row.headline.get(&column).cloned());
        Some([cost?, quality?])
    };
    let point = |(style, row): (usize, &Row)| {
        let [cost, quality] = cells(row)?;
        let at = [cost.mean.filter(|cost| *cost > 0.0)?, quality.mean?];
        let paired = cost.seeds == quality.seeds && cost.n() > 1;
        let seeds = cost.values.iter().zip(&quality.values).map(|(cost, quality)| [*cost, *quality]);
        let seeds = if paired { seeds.collect() } else { Vec::new() };
        let std = [cost.std.unwrap_or(0.0), quality.std.unwrap_or(0.0)];
        Some(Point { style, at, std, seeds, on_front: false })
    };
    let mut points: Vec<Point> = group.rows.iter().enumerate().filter_map(point).collect();
    let complete = complete_seeds(group.rows.iter().filter_map(|row| row.headline.get(&Column::PSNR)));
    let is_complete = |point: &&mut Point| seeds_of(&group.rows[point.style].headline[&Column::PSNR]) == complete;
    let mut compared: Vec<&mut Point> = points.iter_mut().filter(|_| group.one_machine).filter(is_complete).collect();
    let places: Vec<[f64; 2]> = compared.iter().map(|point| point.at).collect();
    for point in &mut compared {
        point.on_front = !places.iter().any(|other| dominates(*other, point.at, cost.higher_is_better()));
    }
    points
}

/// Whether `a` is at least as good as `b` in cost and quality, and better in one of them.
fn dominates(a: [f64; 2], b: [f64; 2], more_is_better: bool) -> bool {
    let (cost_a, cost_b) = if more_is_better { (-a[0], -b[0]) } else { (a[0], b[0]) };
    cost_a <= cost_b && a[1] >= b[1] && (cost_a < cost_b || a[1] > b[1])
}

/// The figure's content as a table, for formats without figures.
fn front_table(content: &Content<'_>, group: &Group, drawn: &[(Column, &str, Vec<Point>)]) -> Table {
    let columns = [Column::PSNR, Column::TrainingSecs, Column::FpsModel];
    let on_front = drawn.iter().map(|(cost, _, _)| match cost {
        Column::TrainingSecs => "on the front (time)".to_owned(),
        _ => "on the front (speed)".to_owned(),
    });
    let header = ["method".into()].into_iter().chain(columns.map(Column::heading)).chain(on_front).collect();
    let mut table = Table::new(format!("Protocol {}: quality and cost", group.name), header);
    for (style, row) in group.rows.iter().enumerate() {
        let mut cells = vec![Text::plain(&row.name)];
        for column in columns {
            let mean = row.headline.get(&column).and_then(|cell| cell.mean);
            let text = Text::plain(mean.map_or(NONE.into(), |mean| number(mean, column.decimals())));
            cells.push(traced(text, content.traces.row(&row.name)));
        }
        for (_, _, points) in drawn {
            let point = points.iter().find(|point| point.style == style);
            let point = point.filter(|_| group.one_machine);
            cells.push(Text::plain(point.map_or(NONE, |point| if point.on_front { "yes" } else { "no" })));
        }
        table.rows.push(cells);
    }
    table.remarks.extend((!group.one_machine).then(|| front(group)));
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dominance_needs_no_loss_and_one_gain() {
        assert!(dominates([1.0, 30.0], [2.0, 29.0], false) && dominates([1.0, 30.0], [1.0, 29.0], false));
        assert!(!dominates([1.0, 28.0], [2.0, 29.0], false) && !dominates([1.0, 30.0], [1.0, 30.0], false));
        assert!(dominates([90.0, 30.0], [80.0, 30.0], true) && !dominates([80.0, 30.0], [90.0, 30.0], true));
    }
}
