//! Charts draw their data to scale and without overlap.

use super::bars::Bars;
use super::lines::{Lines, Series};
use super::scatter::{Point, Scatter};
use super::strips::Strips;
use super::*;
use crate::document::{Figure, Key};
use crate::svg_file::file;

fn numbers(text: &str, attribute: &str) -> Vec<f64> {
    let start = format!(" {attribute}=\"");
    text.match_indices(&start)
        .filter_map(|(at, found)| text[at + found.len()..].split('"').next()?.parse().ok())
        .collect()
}

#[test]
fn bar_segments_are_proportional_to_their_values() {
    let rows = vec![("a".into(), vec![1.0, 2.0, 0.0]), ("b".into(), vec![4.0, 4.0, 2.0])];
    let drawing = Bars { title: "t".into(), x_label: "s".into(), rows }.panel().drawing.into_string();
    let widths = numbers(&drawing, "width");
    assert_eq!(widths.len(), 5, "a segment of length 0 was drawn: {drawing}");
    let per_unit = widths[0];
    let expected = [1.0, 2.0, 4.0, 4.0, 2.0].map(|value| value * per_unit);
    assert!(widths.iter().zip(expected).all(|(width, wanted)| (width - wanted).abs() <= 0.1 * wanted), "{widths:?}");
    assert!(drawing.contains("a: 3.0") && drawing.contains("b: 10.0"));
}

#[test]
fn areas_never_repeat() {
    let areas: std::collections::BTreeSet<String> = (0..28).map(|style| area_sample(style).into_string()).collect();
    assert_eq!(areas.len(), 28);
}

/// A chart of lines through these points.
fn lines(of: &[&[(f64, f64)]]) -> String {
    let points = |of: &&[(f64, f64)]| of.iter().map(|(x, y)| (*x, [*y; 3])).collect();
    let series =
        of.iter().enumerate().map(|(style, of)| Series { style, points: points(of), has_band: false, mark: None });
    let (title, x_label, y_label) = ("t".into(), "x".into(), "y".into());
    Lines { title, x_label, y_label, log_x: false, series: series.collect() }.panel().drawing.into_string()
}

#[test]
fn ticks_leave_space_for_the_label_of_their_axis() {
    for values in [[16.4, 16.6], [1e5, 2e5], [0.0, 4.0]] {
        let drawing = lines(&[&[(0.0, values[0]), (10.0, values[1])]]);
        let ticks: Vec<&str> = drawing.split("<text").filter(|text| text.contains("text-anchor=\"end\"")).collect();
        assert!(ticks.len() >= 3, "{drawing}");
        for tick in ticks {
            let text = tick.split(['>', '<']).nth(1).expect("a label");
            // The label ends 4 px to the right of its baseline at 11 px; a digit is at most 7 px wide.
            let start = numbers(tick, "x")[0] - 7.0 * text.chars().count() as f64;
            assert!(start >= 15.0, "{text} starts at {start} px");
        }
    }
}

#[test]
fn a_thin_line_continues_a_line_that_ends_early() {
    let drawing = lines(&[&[(0.0, 1.0), (5.0, 2.0)], &[(0.0, 1.0), (10.0, 3.0)]]);
    let kept: Vec<Vec<f64>> = drawing
        .split("<path class=\"kept\" d=\"M")
        .skip(1)
        .map(|rest| {
            rest.split('"').next().expect("a path").split([' ', 'H']).filter_map(|part| part.parse().ok()).collect()
        })
        .collect();
    let [early, late] = &kept[..] else { panic!("{drawing}") };
    assert!(early[0] < late[0] && early[2] == late[2] && late[0] == late[2], "{kept:?}");
}

#[test]
fn lines_are_level_between_their_points() {
    let points = vec![(0.0, [1.0; 3]), (10.0, [3.0; 3])];
    let series = vec![Series { style: 0, points, has_band: false, mark: None }];
    let lines = Lines { title: "t".into(), x_label: "x".into(), y_label: "y".into(), log_x: false, series };
    let drawing = lines.panel().drawing.into_string();
    let path = drawing.split("<path d=\"M").nth(1).and_then(|rest| rest.split('"').next()).expect("a line");
    let corners: Vec<Vec<&str>> = path.split('L').map(|corner| corner.split(' ').collect()).collect();
    let [start, level, end] = &corners[..] else { panic!("{path}") };
    assert!(level[1] == start[1] && level[0] == end[0] && start[1] != end[1], "{path}");
}

#[test]
fn strips_are_lighter_for_higher_values() {
    let rows = vec![("m".into(), vec![("first".into(), 20.0), ("second".into(), 30.0)])];
    let strips = Strips { title: "t".into(), ends: ["0".into(), "1".into()], range: [20.0, 30.0], rows };
    let drawing = strips.panel().drawing.into_string();
    assert!(drawing.contains(&hex(strips::SCALE, 0.0)) && drawing.contains(&hex(strips::SCALE, 1.0)), "{drawing}");
    assert!(drawing.contains("<title>second</title>"));
}

#[test]
fn numbers_of_points_do_not_overlap() {
    let point =
        |style: usize, at: [f64; 2]| Point { style, at, std: [0.0; 2], seeds: Vec::new(), on_front: style == 0 };
    let points =
        vec![point(0, [10.0, 30.0]), point(1, [10.05, 30.02]), point(2, [10.1, 29.98]), point(3, [90.0, 20.0])];
    let scatter = Scatter { title: "t".into(), x_label: "x".into(), y_label: "y".into(), points };
    let drawing = scatter.panel().drawing.into_string();
    let places: Vec<(f64, f64)> = (1..=4)
        .map(|number| {
            let end = drawing.find(&format!(">{number}</text>")).expect("a number");
            let tag = &drawing[drawing[..end].rfind("<text").expect("its tag")..end];
            (numbers(tag, "x")[0], numbers(tag, "y")[0])
        })
        .collect();
    for (i, a) in places.iter().enumerate() {
        for b in &places[i + 1..] {
            assert!((a.0 - b.0).abs() >= 9.0 || (a.1 - b.1).abs() >= 9.0, "{places:?}");
        }
    }
    assert_eq!(drawing.matches("class=\"paper\"").count(), 3, "points off the front are hollow");
}

#[test]
fn files_are_balanced_and_self_contained() {
    let panel = || Panel {
        title: "t".into(),
        width: 100.0,
        height: 50.0,
        drawing: html! { (text([1.0, 2.0], "end", "a & b")) },
    };
    let legend = vec![Key { sample: line_sample(0), number: Some(1), label: "one <1>".into() }];
    let figure =
        Figure { file: "f.svg".into(), caption: "c".into(), legend, panels: (0..5).map(|_| panel()).collect() };
    let file = file(&figure);
    for element in ["svg", "g", "text", "path", "rect", "style"] {
        let opened = file.matches(&format!("<{element}>")).count() + file.matches(&format!("<{element} ")).count();
        assert_eq!(opened, file.matches(&format!("</{element}>")).count(), "{element}");
    }
    assert!(file.contains("a &amp; b") && file.contains("1 one &lt;1&gt;") && !file.contains("href"));
    assert!(file.contains("width=\"300\""), "three panels side by side: {}", &file[..200]);
}
