//! Charts as SVG. No distinction depends on colour alone: lines and points differ in dashes and markers and carry the
//! number of their legend entry; areas differ in colour and in the lines across them, and carry that number where it fits;
//! colour scales increase in lightness.

pub(crate) mod bars;
pub(crate) mod lines;
mod plot;
pub(crate) mod scatter;
pub(crate) mod strips;
#[cfg(test)]
mod tests;

use maud::{Markup, html};

use crate::format::number;

/// A chart.
pub(crate) struct Panel {
    /// Title; also drawn.
    pub title: String,
    /// Width in pixels.
    pub width: f64,
    /// Height in pixels.
    pub height: f64,
    /// The SVG elements, inside a box of `width` × `height`.
    pub drawing: Markup,
}

/// Width and height of a sample in the legend, px.
pub(crate) const SAMPLE: [f64; 2] = [30.0, 14.0];

/// Width of every panel, px; fits the screen of a phone.
const WIDTH: f64 = 340.0;

/// The palette of Okabe and Ito, which colour-blind readers can distinguish, with grey instead of yellow and black:
/// yellow is invisible on white, black on a dark background.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9"];
const DASHES: [&str; 5] = ["none", "7 3", "2 3", "9 3 2 3", "4 2"];

fn colour(style: usize) -> &'static str {
    COLOURS[style % COLOURS.len()]
}

fn dash(style: usize) -> &'static str {
    DASHES[style % DASHES.len()]
}

/// A marker at a point: circle, square, triangle, diamond or cross, filled or hollow.
fn marker(style: usize, [x, y]: [f64; 2], filled: bool) -> Markup {
    let shape = match style % 5 {
        0 => "M-3.5 0a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0Z",
        1 => "M-3 -3H3V3H-3Z",
        2 => "M0 -4L4 3H-4Z",
        3 => "M0 -4.5L4 0L0 4.5L-4 0Z",
        _ => "M-3 -3L3 3M3 -3L-3 3",
    };
    let place = format!("translate({} {})", number(x, 1), number(y, 1));
    let (fill, class) = if filled { (colour(style), "") } else { ("#fff", "paper") };
    html! { path transform=(place) d=(shape) class=(class) fill=(fill) stroke=(colour(style)) stroke-width="1.6" {} }
}

/// Legend sample of a line with markers.
pub(crate) fn line_sample(style: usize) -> Markup {
    let [width, height] = SAMPLE;
    let line = format!("M0 {0}H{width}", height / 2.0);
    html! {
        path d=(line) stroke=(colour(style)) stroke-width="1.8" stroke-dasharray=(dash(style)) {}
        (marker(style, [width / 2.0, height / 2.0], false))
    }
}

/// Legend sample of an area.
pub(crate) fn area_sample(style: usize) -> Markup {
    area(style, [0.0; 2], SAMPLE)
}

/// An area with its top left corner at a point. Styles of one colour differ in the number of lines across the area, which is
/// visible at any width.
fn area(style: usize, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> Markup {
    const STEP: f64 = 3.0;
    let line =
        |at: usize| format!("M{} {}h{}", number(x, 1), number(y + height - STEP * at as f64, 1), number(width, 1));
    let lines: String = (1..=style / COLOURS.len()).map(line).collect();
    html! {
        rect x=(number(x, 1)) y=(number(y, 1)) width=(number(width, 1)) height=(height) fill=(colour(style)) stroke="#fff"
            stroke-width="0.7" class="paper-edge" {}
        @if !lines.is_empty() { path d=(lines) stroke="#000" stroke-width="1" {} }
    }
}

/// Legend sample of a colour scale, from low to high.
pub(crate) fn scale_sample(scale: colorous::Gradient) -> Markup {
    const STEPS: usize = 10;
    let [width, height] = SAMPLE;
    let step = width / STEPS as f64;
    html! {
        @for at in 0..STEPS {
            rect x=(number(at as f64 * step, 1)) width=(number(step + 0.2, 1)) height=(height)
                fill=(hex(scale, (at as f64 + 0.5) / STEPS as f64)) {}
        }
    }
}

/// The colour of a scale at `share` in [0, 1], as a hexadecimal code.
fn hex(scale: colorous::Gradient, share: f64) -> String {
    format!("#{:x}", scale.eval_continuous(share.clamp(0.0, 1.0)))
}

/// A text element at a position in pixels; `anchor` is `start`, `middle` or `end`.
fn text([x, y]: [f64; 2], anchor: &str, text: &str) -> Markup {
    html! { text x=(number(x, 1)) y=(number(y, 1)) text-anchor=(anchor) { (text) } }
}
