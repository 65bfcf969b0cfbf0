//! Charts as SVG. Nothing depends on colour alone: lines and points have dashes, shapes and the number of their legend
//! entry, areas have that number, and colour scales rise in lightness.

pub mod bars;
mod file;
pub mod lines;
mod plot;
pub mod scatter;
pub mod strips;
#[cfg(test)]
mod tests;

use maud::{Markup, html};

pub use file::file;

use crate::format::number;

/// A chart.
pub struct Panel {
    /// What it shows; also drawn.
    pub title: String,
    /// Pixels from left to right.
    pub width: f64,
    /// Pixels from top to bottom.
    pub height: f64,
    /// The elements, in this box.
    pub drawing: Markup,
}

/// The box of a legend's sample, px.
pub const SAMPLE: [f64; 2] = [30.0, 14.0];

/// The width of every panel: what fits a phone.
const WIDTH: f64 = 340.0;

/// Okabe and Ito's palette, which stays distinct for colour-blind readers; without yellow and black, which vanish on
/// white and on dark paper.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9"];
const DASHES: [&str; 5] = ["none", "7 3", "2 3", "9 3 2 3", "4 2"];

fn colour(style: usize) -> &'static str {
    COLOURS[style % COLOURS.len()]
}

fn dash(style: usize) -> &'static str {
    DASHES[style % DASHES.len()]
}

/// A circle, square, triangle, diamond or cross around a point, filled or hollow.
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

/// The sample of a line with markers.
pub fn line_sample(style: usize) -> Markup {
    let [width, height] = SAMPLE;
    let line = format!("M0 {0}H{width}", height / 2.0);
    html! {
        path d=(line) stroke=(colour(style)) stroke-width="1.8" stroke-dasharray=(dash(style)) {}
        (marker(style, [width / 2.0, height / 2.0], false))
    }
}

/// The sample of an area.
pub fn area_sample(style: usize) -> Markup {
    let [width, height] = SAMPLE;
    html! { rect width=(width) height=(height) fill=(colour(style)) {} }
}

/// The sample of a colour scale, from low to high.
pub fn scale_sample(scale: colorous::Gradient) -> Markup {
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

/// The colour at `share` in [0, 1] of a scale.
fn hex(scale: colorous::Gradient, share: f64) -> String {
    format!("#{:x}", scale.eval_continuous(share.clamp(0.0, 1.0)))
}

/// `text` at a place; `anchor` is `start`, `middle` or `end`.
fn text([x, y]: [f64; 2], anchor: &str, text: &str) -> Markup {
    html! { text x=(number(x, 1)) y=(number(y, 1)) text-anchor=(anchor) { (text) } }
}
