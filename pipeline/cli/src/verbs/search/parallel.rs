//! Parallel coordinates: one line per completed trial through its values and its objective.

use maud::{Markup, html};
use sweep::{Entry, Space};
use table_generation::{Column, number};

use super::short_key;
use crate::args::Goal;

/// Distance between two axes, px. Half of it is left outside the first and the last axis, for names as wide as those
/// between the others.
const SPACING: f64 = 150.0;
/// Height of the axes, and the space above and below them, px.
const HEIGHT: f64 = 260.0;
const MARGIN: f64 = 60.0;

/// Where lines cross the axis of a parameter that a trial does not set.
const UNSET: f64 = -0.12;

/// Trials with an objective, drawn as an SVG file. The last axis is the objective, better values above; better trials are
/// darker and drawn last.
pub(super) fn svg((space, objective, name): (&Space, Column, &str), completed: &[&Entry]) -> String {
    let mut trials: Vec<(&Entry, f64)> =
        completed.iter().filter_map(|entry| Some((*entry, entry.objective?))).collect();
    trials.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (worst, best) = (trials.first().map_or(0.0, |trial| trial.1), trials.last().map_or(0.0, |trial| trial.1));
    let range = (best - worst).max(f64::MIN_POSITIVE);
    let axes = space.0.len();
    let text = |score: f64| number(Goal::score(objective, score), objective.decimals());
    let width = SPACING * (axes + 1) as f64;
    let line = |(rank, (entry, score)): (usize, &(&Entry, f64))| {
        let relative = (score - worst) / range;
        let is_set = space.active(&entry.point);
        let values = entry.point.iter().zip(is_set).map(|(at, is_set)| if is_set { *at } else { UNSET });
        let heights = values.chain([relative]);
        let corners: Vec<String> =
            heights.enumerate().map(|(axis, at)| format!("{:.1},{:.1}", x(axis), y(at))).collect();
        let is_best = rank + 1 == trials.len();
        let color = format!("hsl(215,70%,{:.0}%)", 85.0 - 50.0 * relative);
        let stroke = if is_best { "#c2410c" } else { &color };
        html! { polyline points=(corners.join(" ")) fill="none" stroke=(stroke) stroke-width=(if is_best { 3 } else { 1 }) {} }
    };
    let markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {}", HEIGHT + 2.0 * MARGIN))
            font-family="Helvetica,Arial,sans-serif" font-size="12" text-anchor="middle" {
            rect width="100%" height="100%" fill="#fff" {}
            @for trial in trials.iter().enumerate() { (line(trial)) }
            @for (at, parameter) in space.0.iter().enumerate() {
                (axis(at, short_key(&parameter.key), [&parameter.at(0.0), &parameter.at(1.0)]))
            }
            (axis(axes, name, [&text(worst), &text(best)]))
        }
    };
    markup.into_string()
}

/// An axis with its name above and its ends.
fn axis(at: usize, name: &str, [low, high]: [&str; 2]) -> Markup {
    html! {
        line x1=(x(at)) x2=(x(at)) y1=(y(0.0)) y2=(y(1.0)) stroke="#555" {}
        text x=(x(at)) y=(y(1.0) - 24.0) font-weight="bold" { (name) }
        text x=(x(at)) y=(y(1.0) - 8.0) { (high) }
        text x=(x(at)) y=(y(0.0) + 18.0) { (low) }
    }
}

fn x(axis: usize) -> f64 {
    SPACING * (axis as f64 + 0.5)
}

fn y(relative: f64) -> f64 {
    MARGIN + HEIGHT * (1.0 - relative)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn the_best_trial_is_the_last_and_thickest_line() {
        let entry = |at: f64, objective: Option<f64>| Entry {
            trial: 0,
            point: vec![at],
            assignments: Vec::new(),
            rung: 0,
            objective,
            values: BTreeMap::new(),
            secs: 1.0,
            steps: 1,
            computed_steps: 1,
            failure: None,
            ended_at_secs: 0.0,
        };
        let entries = [entry(0.5, Some(20.0)), entry(0.0, Some(10.0)), entry(0.9, None)];
        let space = Space(vec!["nodes.train.params.schedule_scale=log(0.1, 1)".parse().unwrap()]);
        let figure = svg((&space, Column::PsnrAtEnd, "PSNR (dB)"), &entries.iter().collect::<Vec<_>>());
        let lines: Vec<&str> = figure.split("<polyline").skip(1).collect();
        assert_eq!(lines.len(), 2, "a trial without a result has no line");
        assert!(
            lines[1].contains(r#"points="75.0,190.0 225.0,60.0""#) && lines[1].contains(r#"stroke-width="3""#),
            "{figure}"
        );
        assert!(
            figure.contains(">schedule_scale<") && figure.contains(">20.00<") && figure.contains(">0.1<"),
            "{figure}"
        );
        assert!(svg((&space, Column::PsnrAtEnd, "PSNR (dB)"), &[]).contains("</svg>"));
    }
}
