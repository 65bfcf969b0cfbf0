//! Quality over seconds: one panel per scene and protocol, one line per method.

use scene::Split;

use crate::collect::{CurvePoint, Run};
use crate::document::Block;
use crate::report::{Group, Report};
use crate::statistics::median;
use crate::svg::{Panel, Series, grid};
use crate::{TableGenerationParams, html};

/// The file of all panels.
pub const ALL_CURVES: &str = "curves.svg";

/// The SVG files of a report by name: [`ALL_CURVES`], and one per scene and protocol.
pub fn svg_files(report: &Report, params: &TableGenerationParams) -> Vec<(String, String)> {
    let panels = panels(report, params);
    let all: Vec<&Panel> = panels.iter().map(|(_, panel)| panel).collect();
    let mut files = vec![(ALL_CURVES.into(), grid(&all))];
    files.extend(panels.iter().map(|(name, panel)| (name.clone(), grid(&[panel]))));
    files
}

/// The figure of all panels; none where no run recorded a curve.
pub fn figures(report: &Report, params: &TableGenerationParams) -> Vec<Block> {
    let panels = panels(report, params);
    if panels.is_empty() {
        return Vec::new();
    }
    let files: Vec<&str> = panels.iter().map(|(name, _)| name.as_str()).collect();
    let caption = format!(
        "Quality over seconds of training (evaluation excluded): median over seeds, band from the lowest to the \
         highest. One file per scene: {}.",
        files.join(", ")
    );
    let all: Vec<&Panel> = panels.iter().map(|(_, panel)| panel).collect();
    vec![Block::Figure { file: ALL_CURVES.into(), svg: grid(&all), caption }]
}

/// File name and panel of every scene with a curve.
fn panels(report: &Report, params: &TableGenerationParams) -> Vec<(String, Panel)> {
    let mut panels = Vec::new();
    for group in &report.groups {
        for scene in &group.scenes {
            let series: Vec<Series> = group
                .rows
                .iter()
                .enumerate()
                .filter_map(|(style, row)| {
                    let belongs = |run: &&Run| {
                        run.scene == *scene && run.row == row.name && run.protocol.as_ref() == Some(&group.protocol)
                    };
                    let curves: Vec<&[CurvePoint]> =
                        report.runs.iter().filter(belongs).map(|run| run.curve.as_slice()).collect();
                    series(&row.name, style, &curves)
                })
                .collect();
            if !series.is_empty() {
                panels.push((file_name(report, group, scene), panel(report, group, scene, series, params)));
            }
        }
    }
    panels
}

fn panel(report: &Report, group: &Group, scene: &str, series: Vec<Series>, params: &TableGenerationParams) -> Panel {
    let protocol = if report.groups.len() > 1 { format!(" (protocol {})", group.name) } else { String::new() };
    Panel {
        title: html::escape(&format!("{scene}{protocol}, {}×{} px", group.protocol.width, group.protocol.height)),
        x_label: "training time (s)".into(),
        y_label: format!("PSNR on {} views (dB)", curve_split(report, group, scene)),
        log_x: params.log_time,
        series,
    }
}

/// The views that a scene's curves were measured on; a capture without validation views has training views only.
fn curve_split(report: &Report, group: &Group, scene: &str) -> &'static str {
    let belongs = |run: &&Run| run.scene == scene && run.protocol.as_ref() == Some(&group.protocol);
    match report.runs.iter().filter(belongs).find_map(|run| run.curve_split) {
        Some(Split::Train) => "training",
        Some(Split::Test) => "test",
        Some(Split::Val) | None => "validation",
    }
}

/// `curves-lego.svg`, with the group's name in front of the scene where there are several groups.
fn file_name(report: &Report, group: &Group, scene: &str) -> String {
    let safe: String = scene.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    let group = if report.groups.len() > 1 { format!("{}-", group.name) } else { String::new() };
    format!("curves-{group}{safe}.svg")
}

/// Median, lowest and highest value over the seeds, at every moment that one of them was evaluated and all have begun.
fn series(label: &str, style: usize, curves: &[&[CurvePoint]]) -> Option<Series> {
    let point = |point: &CurvePoint| {
        let value = (point.seconds, point.psnr_val?);
        (value.0.is_finite() && value.1.is_finite()).then_some(value)
    };
    let curves: Vec<Vec<(f64, f64)>> = curves
        .iter()
        .map(|curve| curve.iter().filter_map(point).collect())
        .filter(|c: &Vec<_>| !c.is_empty())
        .collect();
    let start = curves.iter().map(|curve| curve[0].0).max_by(f64::total_cmp)?;
    let end = curves.iter().map(|curve| curve[curve.len() - 1].0).min_by(f64::total_cmp)?;
    let mut moments: Vec<f64> = curves.iter().flatten().map(|(seconds, _)| *seconds).collect();
    moments.retain(|seconds| (start..=end).contains(seconds));
    moments.sort_by(f64::total_cmp);
    moments.dedup();
    let at = |seconds: &f64| {
        let values: Vec<f64> = curves.iter().map(|curve| interpolated(curve, *seconds)).collect();
        let low = values.iter().copied().min_by(f64::total_cmp)?;
        let high = values.iter().copied().max_by(f64::total_cmp)?;
        Some((*seconds, [low, median(&values)?, high]))
    };
    let points: Vec<_> = moments.iter().filter_map(at).collect();
    (!points.is_empty()).then(|| Series { label: html::escape(label), style, points, has_band: curves.len() > 1 })
}

/// Linear interpolation between the two neighbours in time.
fn interpolated(curve: &[(f64, f64)], seconds: f64) -> f64 {
    let after = curve.partition_point(|point| point.0 < seconds);
    match (after.checked_sub(1).and_then(|before| curve.get(before)), curve.get(after)) {
        (Some(before), Some(after)) => before.1 + (after.1 - before.1) * (seconds - before.0) / (after.0 - before.0),
        (Some(only), None) | (None, Some(only)) => only.1,
        (None, None) => f64::NAN,
    }
}
