//! Quality over training time: one panel per scene and one for their mean, one line per method. Third-party curves are
//! added where they were measured on the same images.

use std::collections::BTreeMap;

use scene::Split;

use super::content::Content;
use super::pareto::legend;
use crate::claims::{PublishedCurve, PublishedCurves};
use crate::collect::{CurvePoint, Run};
use crate::column::Column;
use crate::document::{Block, Figure, Key};
use crate::library;
use crate::params::TableGenerationParams;
use crate::report::{Group, Report, Row};
use crate::statistics::{mean, median};
use crate::svg::line_sample;
use crate::svg::lines::{Lines, Series};

/// A curve as pairs (seconds, dB).
type Curve = Vec<(f64, f64)>;

/// One figure per group in which a run recorded a curve.
pub(crate) fn blocks(content: &Content<'_>) -> anyhow::Result<Vec<Block>> {
    let others = library::curves()?;
    let groups = content.report.groups.iter();
    Ok(groups.flat_map(|group| group_blocks(content, group, &others)).collect())
}

fn group_blocks(content: &Content<'_>, group: &Group, others: &PublishedCurves) -> Vec<Block> {
    let differences = others.protocol.differences_of_images(&group.protocol, &group.judged_by);
    let others_fit = differences.is_empty();
    let theirs: Vec<&PublishedCurve> = if others_fit { relevant(others, group) } else { Vec::new() };
    let mut labels: Vec<&str> = theirs.iter().map(|curve| curve.label.as_str()).collect();
    labels.dedup();
    let drawing = Drawing { content, group, theirs: &theirs, labels: &labels };
    let mut panels: Vec<Lines> = group.scenes.iter().filter_map(|scene| drawing.of_scene(scene)).collect();
    if panels.is_empty() {
        return Vec::new();
    }
    if group.scenes.len() > 1 {
        panels.extend(drawing.of_mean());
    }
    let mut keys = legend(group);
    keys.extend(labels.iter().enumerate().map(|(at, label)| Key {
        sample: line_sample(group.rows.len() + at),
        number: Some(group.rows.len() + at + 1),
        label: format!("{label} (third party)"),
    }));
    let suffix = if content.report.groups.len() > 1 { format!("-{}", group.name) } else { String::new() };
    let figure = Figure {
        file: format!("curves{suffix}.svg"),
        caption: caption(others, others_fit),
        legend: keys,
        panels: panels.into_iter().map(Lines::panel).collect(),
    };
    let is_close = group.protocol.dataset == others.protocol.dataset && !others_fit;
    let absent =
        format!("Curves by {} are not drawn because the protocols differ: {}.", others.source, differences.join("; "));
    let absent = is_close.then_some(Block::Paragraph(absent));
    [Block::Figure(figure)].into_iter().chain(absent).collect()
}

fn caption(others: &PublishedCurves, others_fit: bool) -> String {
    let mut text = String::from(
        "PSNR over training time, evaluation excluded: median over seeds; the band spans the lowest to the highest. A \
         seed keeps its value until its next evaluation, and its last value after the end; where all seeds have ended, \
         the line is thin.",
    );
    if others_fit {
        text += &format!(
            " Third-party lines: {}, on {}, as of {}, PSNR on test views. Filled markers are final test scores of this \
             project; only these are comparable with the third-party lines.",
            others.source, others.hardware, others.taken
        );
        text.extend(others.notes.iter().map(|note| format!(" Note: {note}.")));
    }
    text
}

/// The third-party curves on the scenes of a group, sorted by method.
fn relevant<'a>(others: &'a PublishedCurves, group: &Group) -> Vec<&'a PublishedCurve> {
    let mut curves: Vec<_> = others.curve.iter().filter(|curve| group.scenes.contains(&curve.scene)).collect();
    curves.sort_by_key(|curve| &curve.label);
    curves
}

/// Input of the panels of one group.
struct Drawing<'a> {
    content: &'a Content<'a>,
    group: &'a Group,
    theirs: &'a [&'a PublishedCurve],
    labels: &'a [&'a str],
}

impl Drawing<'_> {
    fn of_scene(&self, scene: &str) -> Option<Lines> {
        let ours = self.group.rows.iter().enumerate().filter_map(|(style, row)| {
            let curves: Vec<Curve> = self.runs(row, scene).map(|run| points(&run.curve)).collect();
            let mark = self.marked(row.by_scene.get(scene));
            series(style, &curves, mark)
        });
        let theirs = self.theirs.iter().filter(|curve| curve.scene == scene);
        let theirs = theirs.filter_map(|curve| series(self.style(&curve.label), &[published(curve)], None));
        let lines: Vec<Series> = ours.chain(theirs).collect();
        (!lines.is_empty())
            .then(|| self.lines(scene.to_owned(), curve_split(self.content.report, self.group, scene), lines))
    }

    /// The mean over the scenes, for every seed that has a curve in all of them.
    fn of_mean(&self) -> Option<Lines> {
        let ours = self.group.rows.iter().enumerate().filter_map(|(style, row)| {
            let of_scene = |scene: &String| -> BTreeMap<String, Curve> {
                self.runs(row, scene).map(|run| (run.seed.clone(), points(&run.curve))).collect()
            };
            let by_scene: Vec<BTreeMap<String, Curve>> = self.group.scenes.iter().map(of_scene).collect();
            let of_seed =
                |seed: &String| by_scene.iter().map(|curves| curves.get(seed)).collect::<Option<Vec<&Curve>>>();
            let whole = by_scene.first()?.keys().filter_map(of_seed);
            let curves: Vec<Curve> = whole.map(|curves| mean_curve(&curves)).collect();
            series(style, &curves, self.marked(Some(&row.headline)))
        });
        let theirs = self.labels.iter().filter_map(|label| {
            let curves: Vec<Curve> =
                self.theirs.iter().filter(|curve| curve.label == *label).map(|curve| published(curve)).collect();
            let is_whole = curves.len() == self.group.scenes.len();
            let curve = is_whole.then(|| mean_curve(&curves.iter().collect::<Vec<_>>()))?;
            series(self.style(label), &[curve], None)
        });
        let lines: Vec<Series> = ours.chain(theirs).collect();
        let split = curve_split(self.content.report, self.group, self.group.scenes.first()?);
        let title = format!("mean of {} scenes", self.group.scenes.len());
        (!lines.is_empty()).then(|| self.lines(title, split, lines))
    }

    fn runs<'r>(&'r self, row: &'r Row, scene: &'r str) -> impl Iterator<Item = &'r Run> {
        let belongs = move |run: &&Run| {
            run.scene == scene && run.row == row.name && self.group.holds(run) && run.degenerate.is_none()
        };
        self.content.report.runs.iter().filter(belongs).filter(|run| !points(&run.curve).is_empty())
    }

    /// Seconds and PSNR of the final test score; drawn only next to third-party curves, which show test scores.
    fn marked(&self, cells: Option<&crate::cell::Cells>) -> Option<[f64; 2]> {
        let mean = |column| cells?.get(&column)?.mean;
        mean(Column::TrainingSecs).zip(mean(Column::PSNR)).filter(|_| !self.theirs.is_empty()).map(|(x, y)| [x, y])
    }

    fn style(&self, label: &str) -> usize {
        self.group.rows.len() + self.labels.iter().position(|known| *known == label).unwrap_or(0)
    }

    fn lines(&self, title: String, split: &str, series: Vec<Series>) -> Lines {
        let TableGenerationParams { log_time, .. } = *self.content.params;
        let label = self.group.label(self.content.report);
        let title = if label.is_empty() { title } else { format!("{title} ({label})") };
        let x_label = if log_time { "training time (s, log)" } else { "training time (s)" };
        Lines { title, x_label: x_label.into(), y_label: format!("PSNR, {split} views (dB)"), log_x: log_time, series }
    }
}

/// The views on which a scene's curves were measured: validation views, or training views without a validation split.
pub(super) fn curve_split(report: &Report, group: &Group, scene: &str) -> &'static str {
    let belongs = |run: &&Run| run.scene == scene && group.holds(run);
    match report.runs.iter().filter(belongs).find_map(|run| run.curve_split) {
        Some(Split::Train) => "training",
        Some(Split::Test) => "test",
        Some(Split::Val) | None => "validation",
    }
}

fn points(curve: &[CurvePoint]) -> Curve {
    let point = |point: &CurvePoint| {
        let value = (point.seconds, point.psnr_val?);
        (value.0.is_finite() && value.1.is_finite()).then_some(value)
    };
    curve.iter().filter_map(point).collect()
}

fn published(curve: &PublishedCurve) -> Curve {
    curve.seconds.iter().copied().zip(curve.psnr.iter().copied()).collect()
}

/// The mean of curves at every evaluation of one of them.
fn mean_curve(curves: &[&Curve]) -> Curve {
    at_evaluations(curves).into_iter().filter_map(|(seconds, values)| Some((seconds, mean(&values)?))).collect()
}

/// Median, lowest and highest value over the seeds at every evaluation of one of them.
fn series(style: usize, curves: &[Curve], mark: Option<[f64; 2]>) -> Option<Series> {
    let curves: Vec<&Curve> = curves.iter().filter(|curve| !curve.is_empty()).collect();
    let spread = |(seconds, values): (f64, Vec<f64>)| {
        let low = values.iter().copied().min_by(f64::total_cmp)?;
        let high = values.iter().copied().max_by(f64::total_cmp)?;
        Some((seconds, [low, median(&values)?, high]))
    };
    let points: Vec<_> = at_evaluations(&curves).into_iter().filter_map(spread).collect();
    (!points.is_empty()).then_some(Series { style, points, has_band: curves.len() > 1, mark })
}

/// The values of all curves at every evaluation of one of them, from the time at which all have started. As under a
/// deadline, the value of a curve is that of its last evaluation: values between evaluations were not measured.
fn at_evaluations(curves: &[&Curve]) -> Vec<(f64, Vec<f64>)> {
    let mut times: Vec<f64> = curves.iter().copied().flatten().map(|(seconds, _)| *seconds).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let last = |curve: &Curve, time: f64| {
        let n_before = curve.partition_point(|(seconds, _)| *seconds <= time);
        Some(curve.get(n_before.checked_sub(1)?)?.1)
    };
    let values = |time: f64| Some((time, curves.iter().map(|curve| last(curve, time)).collect::<Option<Vec<f64>>>()?));
    times.into_iter().filter_map(values).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_keep_the_last_evaluation_to_the_latest_end() {
        let curves = [vec![(0.0, 10.0), (10.0, 20.0)], vec![(1.0, 12.0), (5.0, 16.0), (20.0, 30.0)]];
        let series = series(0, &curves, None).expect("a line");
        let expected = [
            (1.0, [10.0, 11.0, 12.0]),
            (5.0, [10.0, 13.0, 16.0]),
            (10.0, [16.0, 18.0, 20.0]),
            (20.0, [20.0, 25.0, 30.0]),
        ];
        assert_eq!(series.points, expected);
    }
}
